"""Boost.odeint, compiled here; needs g++ and the Boost headers (Debian: libboost-dev)."""

import ctypes
import subprocess
import tempfile
from pathlib import Path

import numpy as np
from scenes import OSCILLATOR, Scene

TOLERANCES = tuple(10.0**-k for k in range(3, 13))
_DOUBLES = ctypes.POINTER(ctypes.c_double)


class Odeint:
    """One point at a time; `form` is ``piecewise`` or ``tanh:<epsilon>``."""

    width = 1

    def __init__(self, form):
        self.name = "odeint dopri5"
        self.epsilon = 0.0 if form == "piecewise" else float(form.partition(":")[2])
        source = Path(__file__).parent / "odeint.cpp"
        target = Path(tempfile.mkdtemp()) / "odeint.so"
        flags = ["-std=c++17", "-O3", "-march=native", "-shared", "-fPIC"]
        subprocess.run(["g++", *flags, "-o", target, source], check=True)
        self.library = ctypes.CDLL(str(target))
        self.library.integrate.argtypes = [_DOUBLES, *[ctypes.c_double] * 3, _DOUBLES]

    def run(self, scene: Scene, tolerance):
        """End state of the scene: (x, v), each of shape (1,)."""
        o = OSCILLATOR
        linear = [o.omega_n_rad**2, 2.0 * o.decay_rate, o.alpha / o.mass, o.forcing / o.mass]
        contact = [2.0 * np.pi * scene.omega, scene.K_c / o.mass, scene.j_1, scene.j_2]
        parameters = np.array([*linear, *contact, self.epsilon])
        end = np.zeros(2)
        pointers = [a.ctypes.data_as(_DOUBLES) for a in (parameters, end)]
        self.library.integrate(pointers[0], scene.t_end, tolerance, 1e-3 * tolerance, pointers[1])
        return end[:1], end[1:]
