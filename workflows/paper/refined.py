"""What a grid is too coarse for: ends of bands, narrow windows, basins, short motions, a scan.

They are computed directly: a grid this fine would have all other cases on it too.
"""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray
from scipy.stats import qmc

from gapsweep.integrate.simulate import simulate
from gapsweep.model.contact import ContactLaw
from gapsweep.model.labels import Representation, contact_law
from gapsweep.model.oscillator import Gap
from gapsweep.response.respond import respond_all
from gapsweep.response.result import Response
from gapsweep.response.scene import Scene
from gapsweep.study.study import Study

from .scenes import (
    EXACT,
    HARD_ASYMMETRIC,
    HARD_SYMMETRIC,
    NO_EVENTS,
    SOFT_SYMMETRIC,
    STARTS,
    WEAK,
    Case,
    width,
)

Floats = NDArray[np.float64]

FINEST = 1e-3  # Hz; how finely ends of bands are known
_PEAK = (7.0, 16.0)  # Hz, where the primary resonance of the soft contact is
_SUBHARMONIC = (12.0, 30.0)
_BAND = (17.0, 21.0)  # Hz, where the paper's Figs 6b and 8b have period 3
N_STARTS = 400
_BOX = ((-2e-3, -0.05), (2e-3, 0.05))  # x [m], v [m/s], as in the study
BASINS = {
    SOFT_SYMMETRIC: ((17.0, 19.0, 21.0), (EXACT, *WEAK)),
    HARD_ASYMMETRIC: ((11.0, 21.75), (EXACT, NO_EVENTS, "tanh-1e6", "tanh-1e9")),
}
WINDOWS = (
    EXACT, f"{EXACT}@half", f"{EXACT}@jitter", "tanh-1e6", "arctan-1e6", "logarctan-1e6",
)  # fmt: skip
_PAPER = tuple(f"{law}@paper" for law in (EXACT, NO_EVENTS, "tanh-1e6", "tanh-1e9"))
_PAPER += (f"{EXACT}@paper-mode",)
CLOUD = (EXACT, *_PAPER)
TRUTH = "truth"  # the exact law with the tightest tolerances
MOTIONS = (TRUTH, f"{EXACT}@jitter", f"{EXACT}@finer", f"{NO_EVENTS}@finer", *_PAPER)
N_PERIODS, _PER_PERIOD = 4, 64
_X_0, _V_0 = np.array(list(STARTS.values())).T[..., None]  # to broadcast against frequencies
_VARIABLES = {
    "peak": ("Hz", "frequency up to which the response is on the upper branch"),
    "low": ("Hz", "lower end of the widest period-3 band"),
    "high": ("Hz", "upper end of the widest period-3 band"),
    "period_multiple": ("1", "n of a period-n response, 0: none"),
    "response_class": ("1", "class of the response"),
    "x": ("m", "displacement"),
    "width": ("m", "gap"),
    "inside": ("1", "share of the frequencies in the paper's band that have period 3"),
    "outside": ("1", "share of the frequencies outside of it that have period 3"),
    "x_0": ("m", "initial displacement"),
    "v_0": ("m s-1", "initial velocity"),
}


def _dataset(values: Mapping[str, Any], **coords: Any) -> xr.Dataset:
    """A dataset whose variables have the units and names of `_VARIABLES`."""
    found = xr.Dataset(values, coords)
    for name in _VARIABLES.keys() & found.variables.keys():
        units, long_name = _VARIABLES[name]
        found[name].attrs = {"units": units, "long_name": long_name}
    return found


def bands(study: Study) -> xr.Dataset:
    """Where the primary peak and the widest period-3 band end, soft symmetric contact.

    Returns
    -------
    Dataset
        Over ``representation`` and ``start``: ``peak``, ``low``, ``high`` [Hz], each within
        `FINEST`; NaN where there is none. An end is one change of the response at a step of the
        grid; where basins are finely divided there may be others.
    """
    labels, dims = (EXACT, *WEAK), ("representation", "start")
    found = [[(_peak(study, r, s), *_period_3(study, r, s)) for s in STARTS] for r in labels]
    peak, low, high = np.moveaxis(np.array(found), -1, 0)
    values = {"peak": (dims, peak), "low": (dims, low), "high": (dims, high)}
    return _dataset(values, representation=list(labels), start=list(STARTS))


def windows(study: Study) -> xr.Dataset:
    """Periods and classes at every 0.02 Hz where windows are narrow, hard symmetric contact.

    Returns
    -------
    Dataset
        ``period_multiple`` (0: not periodic) and ``response_class`` over ``representation``,
        ``start`` and ``omega``.
    """
    omega, dims = np.arange(10.0, 30.01, 0.02).round(2), ("representation", "start", "omega")
    found = [_responses(study, r, HARD_SYMMETRIC, omega, _X_0, _V_0) for r in WINDOWS]
    values = {
        name: (dims, np.array([getattr(one, name) for one in found], "i4"))
        for name in ("period_multiple", "response_class")
    }
    return _dataset(values, representation=list(WINDOWS), start=list(STARTS), omega=omega)


def basins(study: Study) -> xr.Dataset:
    """Periods of the steady responses from `N_STARTS` initial conditions where basins decide.

    Returns
    -------
    Dataset
        ``period_multiple`` (0: not periodic) over ``case`` and ``start``, with ``representation``,
        ``K_c``, ``gap`` and ``omega`` of each case.
    """
    x_0, v_0 = qmc.scale(qmc.Sobol(2, rng=1).random(512)[:N_STARTS], *_BOX).T
    cases = [
        (label, *case, omega)
        for case, (frequencies, labels) in BASINS.items()
        for label in labels
        for omega in frequencies
    ]
    found = [_responses(study, r, (K_c, gap), w, x_0, v_0) for r, K_c, gap, w in cases]
    periods = np.array([one.period_multiple for one in found], "i4")
    names = ("representation", "K_c", "gap", "omega")
    columns = zip(*cases, strict=True)
    coords = {n: ("case", list(column)) for n, column in zip(names, columns, strict=True)}
    return _dataset({"period_multiple": (("case", "start"), periods)}, **coords)


def cloud(study: Study) -> xr.Dataset:
    """Periods at 11 Hz from 101 initial conditions within 5 nm, hard asymmetric contact (Fig. 11).

    Returns
    -------
    Dataset
        ``period_multiple`` (0: not periodic) over ``representation``, ``start`` and ``x_0``.
    """
    dims, near = ("representation", "start", "x_0"), np.linspace(-5e-9, 5e-9, 101)
    found = [_responses(study, r, HARD_ASYMMETRIC, 11.0, _X_0 + near, _V_0) for r in CLOUD]
    periods = np.array([one.period_multiple for one in found], "i4")
    values = {"period_multiple": (dims, periods)}
    return _dataset(values, representation=list(CLOUD), start=list(STARTS))


def starts(study: Study) -> xr.Dataset:
    """Which initial conditions give the exact law the period-3 band of the paper's Fig. 8b.

    Returns
    -------
    Dataset
        Over ``x_0`` [m] and ``v_0`` [m/s]: share of the frequencies with period 3 ``inside`` the
        band, 17 to 21 Hz, and ``outside`` it, above 12 Hz.
    """
    omega = np.arange(12.0, 30.05, 0.1).round(1)
    x_0, v_0 = np.linspace(-1e-3, 1e-3, 41), np.linspace(-0.05, 0.05, 5)
    points = np.meshgrid(omega, x_0, v_0, indexing="ij")
    hits = np.equal(_responses(study, EXACT, SOFT_SYMMETRIC, *points).period_multiple, 3)
    is_inside = (omega >= _BAND[0]) & (omega <= _BAND[1])
    shares = {"inside": hits[is_inside].mean(axis=0), "outside": hits[~is_inside].mean(axis=0)}
    return _dataset({n: (("x_0", "v_0"), s) for n, s in shares.items()}, x_0=x_0, v_0=v_0)


def motions(study: Study) -> xr.Dataset:
    """Displacements in the fourth forcing period, hard asymmetric contact, every 0.1 Hz.

    Over so short a time the error of a method has not yet grown to another motion: the growth is
    the distance of the exact law from 1 nm away.

    Returns
    -------
    Dataset
        ``x`` [m] over ``representation``, ``start``, ``omega`` and ``sample``; ``response_class``
        of the exact law over ``start`` and ``omega``; ``width`` of the gap [m].
    """
    omega = np.arange(1.0, 30.01, 0.1).round(1)
    x = [[[_motion(study, r, w, s) for w in omega.tolist()] for s in STARTS] for r in MOTIONS]
    classes = _responses(study, EXACT, HARD_ASYMMETRIC, omega, _X_0, _V_0).response_class
    dims = ("representation", "start", "omega", "sample")
    values = {
        "x": (dims, np.array(x)),
        "response_class": (dims[1:3], np.array(classes, "i4")),
        "width": ((), width(HARD_ASYMMETRIC)),
    }
    return _dataset(values, representation=list(MOTIONS), start=list(STARTS), omega=omega)


def _motion(study: Study, label: str, omega: float, start: str) -> Floats:
    """Displacements [m] of one motion in its last period."""
    x_0, v_0 = STARTS[start]
    settings: dict[str, Any] = {"rtol": 1e-12, "atol": 1e-15}
    if label != TRUTH:
        solver, x_0 = study.solver(label), x_0 + study.start_jitter(label)
        names = ("engine", "rtol", "atol", "controller", "restart", "contact_force")
        settings = {name: getattr(solver, name) for name in names}
    law = _law(EXACT if label == TRUTH else label, HARD_ASYMMETRIC)
    t_end = N_PERIODS / omega
    motion = simulate(
        study.oscillator, law, omega, x_0, v_0, t_end=t_end, dense_output=True, **settings
    )
    t = (N_PERIODS - 1 + (np.arange(_PER_PERIOD) + 0.5) / _PER_PERIOD) / omega
    return np.asarray(motion.sample(t)[0])


def _law(label: str, case: Case) -> ContactLaw:
    j_1, j_2 = (1e-3 * float(j) for j in case[1].split("/"))
    return contact_law(Representation(label).law, case[0], Gap(j_1, j_2))


def _responses(
    study: Study, label: str, case: Case, omega: ArrayLike, x_0: ArrayLike, v_0: ArrayLike
) -> Response:
    """Steady responses of a law, with the solver that the study has for it."""
    law, solver = _law(label, case), study.solver(label)
    omega, x_0, v_0 = np.broadcast_arrays(omega, np.add(x_0, study.start_jitter(label)), v_0)
    scenes = [
        Scene(oscillator=study.oscillator, law=law, omega=one, solver=solver)
        for one in omega.ravel().tolist()
    ]
    found = respond_all(scenes, np.stack([x_0.ravel(), v_0.ravel()], axis=1), study.steady)
    return found.shaped(omega.shape)


def _peak(study: Study, label: str, start: str) -> float:
    """The frequency at which the largest response jumps down."""
    omega = np.arange(*_PEAK, 0.1).round(1)

    def amplitudes(omega: Floats) -> Floats:
        return np.asarray(_responses(study, label, SOFT_SYMMETRIC, omega, *STARTS[start]).amplitude)

    amplitude = amplitudes(omega)
    at = int(np.nanargmax(amplitude))
    if at + 1 == omega.size:
        return float("nan")
    half = 0.5 * (amplitude[at] + amplitude[at + 1])
    return _changes(lambda w: amplitudes(w) > half, omega[at], omega[at + 1])


def _period_3(study: Study, label: str, start: str) -> tuple[float, float]:
    """Both ends of the widest band of the grid in which a start leads to period 3."""
    omega = np.arange(*_SUBHARMONIC, 0.1).round(1)

    def is_3(omega: Floats) -> NDArray[np.bool_]:
        found = _responses(study, label, SOFT_SYMMETRIC, omega, *STARTS[start])
        return np.asarray(np.equal(found.period_multiple, 3))

    found = runs(is_3(omega))
    if not found:
        return float("nan"), float("nan")
    i, j = max(found, key=lambda run: run[1] - run[0])
    low = _changes(is_3, omega[i], omega[i - 1]) if i else omega[0]
    high = _changes(is_3, omega[j - 1], omega[j]) if j < omega.size else omega[-1]
    return float(low), float(high)


def runs(hits: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """First index of every run of hits, and the index after its last."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], hits.astype(int), [0]])))
    return [(int(i), int(j)) for i, j in edges.reshape(-1, 2)]


def _changes(holds: Callable[[Floats], NDArray[np.bool_]], inside: float, outside: float) -> float:
    """Where a condition that holds at one frequency stops to hold on the way to another."""
    while abs(outside - inside) > FINEST:
        between = np.linspace(inside, outside, 18)  # sixteen cost little more than one
        n = int(np.argmin([*holds(between[1:-1]), False]))
        inside, outside = between[n], between[n + 1]
    return float(inside)
