"""Published systems with freeplay, each with its contact law, its source and its numbers.

A function ``NAME`` returns the `gapsweep.System`, ``NAME_law`` the law of its contact::

    system, law = gs.systems.two_masses(), gs.systems.two_masses_law()
    motion = gs.simulate(system, law, omega=0.1, t_end=100.0)

``paper_oscillator`` returns a `gapsweep.Oscillator`; its contact law is a separate argument.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gapsweep.errors import ModelError
from gapsweep.model.contact import Piecewise
from gapsweep.model.oscillator import Gap, Oscillator, checked
from gapsweep.model.system import Harmonic, Lags, Modulation, System

__all__ = [
    "FREEPLAY",
    "gear_pair",
    "gear_pair_law",
    "paper_oscillator",
    "soft_impact_oscillator",
    "soft_impact_oscillator_law",
    "two_masses",
    "two_masses_law",
    "typical_section",
    "typical_section_law",
]

Array = NDArray[np.float64]

# Flap freeplay of the typical section on either side [rad]: 2.12 degrees.
FREEPLAY = math.radians(2.12)

# Table 1 of the paper.
_PAPER = {"zeta": 0.03, "omega_n": 5.0, "mass": 3.0, "alpha": 7e8, "forcing": 4.0}

# Semichord [m]; elastic axis and hinge of the flap, in semichords behind the middle of the chord.
_SEMICHORD, _AXIS, _HINGE = 0.127, -0.5, 0.5

# R. T. Jones's approximation of Theodorsen's function, 1 - sum A_i s / (s + B_i U/b).
_LAG_PARTS, _LAG_RATES = np.array([0.165, 0.335]), np.array([0.0455, 0.300])


@dataclass(frozen=True, slots=True, kw_only=True)
class _Section:
    """Structural parameters of the typical section in one publication, per metre of span.

    Mass of the wing m [kg/m] and of all plunging parts m_t [kg/m]; static moments [kg], moments of
    inertia [kg m], springs [N/m², N, N] and damping ratios of plunge, pitch and flap.
    """

    m: float
    m_t: float
    S_alpha: float = 0.08587
    S_beta: float = 0.00395
    I_alpha: float = 0.01347
    I_beta: float = 0.0003264
    springs: tuple[float, float, float] = (2818.8, 37.34, 3.9)
    zeta: tuple[float, float, float] = (0.0113, 0.01626, 0.0115)

    def mass(self) -> Array:
        product = self.I_beta + _SEMICHORD * (_HINGE - _AXIS) * self.S_beta
        return np.array(
            [
                [self.m_t, self.S_alpha, self.S_beta],
                [self.S_alpha, self.I_alpha, product],
                [self.S_beta, product, self.I_beta],
            ]
        )

    def damping(self) -> Array:
        """Return diagonal damping: ``2 zeta sqrt(k I)`` of each uncoupled coordinate."""
        inertias = np.array([self.m, self.I_alpha, self.I_beta])
        return np.diag(2.0 * np.array(self.zeta) * np.sqrt(np.array(self.springs) * inertias))


def _from_ratios(m: float, m_t: float) -> _Section:
    """Return the section from its published distances, radii [semichords] and frequencies."""
    x_alpha, x_beta = 0.4340, 0.02
    lengths = np.array([1.0, _SEMICHORD * 0.7321, _SEMICHORD * 0.1140])
    inertias = m * lengths**2
    k_h, k_alpha, k_beta = inertias * np.array([42.5352, 52.6506, 109.3093]) ** 2
    return _Section(
        m=m,
        m_t=m_t,
        S_alpha=m * _SEMICHORD * x_alpha,
        S_beta=m * _SEMICHORD * x_beta,
        I_alpha=inertias[1],
        I_beta=inertias[2],
        springs=(k_h, k_alpha, k_beta),
    )


_COPIES = {
    "darabseh": _Section(m=1.558, m_t=3.3843, zeta=(0.0133, 0.01626, 0.0133)),
    "conner-scaled": _from_ratios(m=1.5666, m_t=3.39298),
}


def __dir__() -> list[str]:
    return __all__


def paper_oscillator(**changes: float) -> Oscillator:
    """Return the Duffing oscillator of the paper that gapsweep reproduces.

    zeta = 0.03, omega_n = 5 Hz, mass = 3 kg, alpha = 7e8 N/m³, forcing = 4 N.

    Parameters
    ----------
    **changes
        Parameters of `gapsweep.Oscillator` with other values.

    Raises
    ------
    ModelError
        If a name is no parameter of it, or a value is out of range.

    Examples
    --------
    >>> import gapsweep as gs
    >>> gs.systems.paper_oscillator(alpha=0.0).omega_n
    5.0
    """
    return Oscillator(**{**_PAPER, **changes})


def typical_section(speed: float, copy: str = "darabseh", density: float = 1.225) -> System:
    """Return a wing section in an air stream with freeplay at its flap, three coordinates.

    Coordinates are plunge ``h`` [m, down], pitch ``alpha`` [rad, nose up] and flap ``beta`` [rad,
    trailing edge down, against the wing]; all forces are those of a metre of span::

        (M + M_a) q'' + (C + C_a) q' + (K + K_a) q + (0, 0, F(beta)) + R (A_1 z_1 + A_2 z_2) = 0
        z_i' = (B_i U/b) (w - z_i),      w = e.q' + g.q,      A = 0.165, 0.335, B = 0.0455, 0.300

    The air is incompressible and potential (Theodorsen, NACA Report 496, 1935), with R. T. Jones's
    lags of the downwash w at three quarters of the chord; b = 0.127 m. The flap's spring is the
    contact ``flap``, hence no part of K. The system is self-excited: it has no `omega`.

    Parameters
    ----------
    speed : float
        Air speed U [m/s], ``> 0``; published studies cover 4 to 24.
    copy : str
        Source of the parameters: ``"darabseh"``, or ``"conner-scaled"`` from the dimensionless
        ratios of Conner et al.
    density : float
        Air density [kg/m³], ``>= 0``.

    Notes
    -----
    Conner, Tang, Dowell and Virgin, *J. Fluids Struct.* 11 (1997) 89-109. Printed: linear flutter,
    the flap on its spring, at 23.9 m/s; it is at 23.898 and 23.846 m/s in the two copies.
    They disagree in masses (m 1.558 or 1.5666 kg/m, total plunging mass 3.3843 or 3.39298) and
    damping ratios (0.0133, 0.01626, 0.0133 or 0.0113, 0.01626, 0.0115), applied here to each
    uncoupled coordinate. Published from h = 0.01 m: with ``"conner-scaled"`` an asymmetric
    limit cycle at 12.36842 m/s, and a change to another at 12.7778 m/s.

    Raises
    ------
    ModelError
        If an argument is out of range.

    Examples
    --------
    >>> import gapsweep as gs
    >>> gs.systems.typical_section(12.0).coordinates
    ('h', 'alpha', 'beta')
    """
    speed = checked("speed", speed, low=0.0, strict=True)
    density = checked("density", density, low=0.0)
    section = _section(copy)
    air = _aerodynamics(speed, density)
    at_once, rates = 1.0 - _LAG_PARTS.sum(), _LAG_RATES * speed / _SEMICHORD
    k_h, k_alpha, _ = section.springs
    return System(
        mass=section.mass() + air.mass,
        damping=section.damping() + air.damping + at_once * np.outer(air.load, air.of_speed),
        stiffness=np.diag([k_h, k_alpha, 0.0])
        + air.stiffness
        + at_once * np.outer(air.load, air.of_place),
        contacts={"flap": [0.0, 0.0, 1.0]},
        lags=Lags(
            force=np.outer(air.load, _LAG_PARTS),
            of_speed=np.outer(rates, air.of_speed),
            of_place=np.outer(rates, air.of_place),
            of_lags=np.diag(-rates),
        ),
        coordinates=("h", "alpha", "beta"),
        units={"alpha": "rad", "beta": "rad"},
    )


def typical_section_law(copy: str = "darabseh", freeplay: float = FREEPLAY) -> Piecewise:
    """Return the contact law of the flap of `typical_section`.

    Parameters
    ----------
    copy : str
        As in `typical_section`.
    freeplay : float
        Freeplay on either side [rad], ``>= 0``; published 2.12 degrees. 0: a linear section.

    Examples
    --------
    >>> import gapsweep as gs
    >>> gs.systems.typical_section_law().K_c
    3.9
    """
    section, freeplay = _section(copy), checked("freeplay", freeplay, low=0.0)
    return Piecewise(section.springs[2], Gap(freeplay, freeplay))


def _section(copy: str) -> _Section:
    if copy not in _COPIES:
        raise ModelError(f"copy = {copy!r}: must be one of {list(_COPIES)}")
    return _COPIES[copy]


@dataclass(frozen=True, slots=True, kw_only=True)
class _Air:
    """Aerodynamic loads ``mass q'' + damping q' + stiffness q + load C(k) w``.

    The first three are not circulatory; the downwash is ``w = of_speed q' + of_place q``.
    """

    mass: Array
    damping: Array
    stiffness: Array
    load: Array
    of_speed: Array
    of_place: Array


def _aerodynamics(speed: float, density: float) -> _Air:
    """Return Theodorsen's loads per metre of span; rows and columns are plunge, pitch, flap."""
    a, b, c = _AXIS, _SEMICHORD, _HINGE
    T = _theodorsen_constants(a, c)
    pi = math.pi
    mass = [
        [pi, -pi * a * b, -T[1] * b],
        [-pi * a * b, pi * b**2 * (1 / 8 + a * a), 2 * T[13] * b**2],
        [-T[1] * b, 2 * T[13] * b**2, -T[3] * b**2 / pi],
    ]
    pitch_by_flap = T[1] - T[8] - (c - a) * T[4] + T[11] / 2
    flap_by_pitch = -2 * T[9] - T[1] + T[4] * (a - 0.5)
    damping = [
        [0.0, pi, -T[4]],
        [0.0, pi * (0.5 - a) * b, pitch_by_flap * b],
        [0.0, flap_by_pitch * b, -T[4] * T[11] * b / (2 * pi)],
    ]
    stiffness = np.zeros((3, 3))
    stiffness[1:, 2] = T[4] + T[10], (T[5] - T[4] * T[10]) / pi
    return _Air(
        mass=density * b**2 * np.array(mass),
        damping=density * b**2 * speed * np.array(damping),
        stiffness=density * b**2 * speed**2 * stiffness,
        load=density * b * speed * np.array([2 * pi, -2 * pi * b * (a + 0.5), b * T[12]]),
        of_speed=np.array([1.0, b * (0.5 - a), b * T[11] / (2 * pi)]),
        of_place=speed * np.array([0.0, 1.0, T[10] / pi]),
    )


def _theodorsen_constants(a: float, c: float) -> dict[int, float]:
    """Return Theodorsen's constants T_i by i; elastic axis `a` and hinge `c` [semichords]."""
    s, angle = math.sqrt(1 - c * c), math.acos(c)
    T = {
        1: -s * (2 + c * c) / 3 + c * angle,
        3: -(1 / 8 + c * c) * angle**2
        + c * s * angle * (7 + 2 * c * c) / 4
        - s**2 * (5 * c * c + 4) / 8,
        4: -angle + c * s,
        5: -(s**2) - angle**2 + 2 * c * s * angle,
        7: -(1 / 8 + c * c) * angle + c * s * (7 + 2 * c * c) / 8,
        8: -s * (2 * c * c + 1) / 3 + c * angle,
        10: s + angle,
        11: angle * (1 - 2 * c) + s * (2 - c),
        12: s * (2 + c) - angle * (2 * c + 1),
    }
    T[9] = (s**3 / 3 + a * T[4]) / 2
    T[13] = -(T[7] + (c - a) * T[1]) / 2
    return T


def two_masses() -> System:
    """Return a chain of two masses; a one-sided elastic stop limits the first.

    Without dimensions::

        x_1'' + 0.03 (x_1' - x_2') + x_1 - x_2 + F(x_1) = 0
        x_2'' + 0.03 (2 x_2' - x_1') + 2 x_2 - x_1      = 0.1 cos(2 pi omega t)

    The source sweeps 2 pi omega from 0.8 down to 0.5.

    Notes
    -----
    Example 03 of NLvib, with M. Krack and J. Gross, *Harmonic Balance for Nonlinear Vibration
    Problems*, Springer 2019. Printed: a stable response of one period at 2 pi omega = 0.635,
    and at 0.6 one beyond a Neimark-Sacker bifurcation.

    Examples
    --------
    >>> import gapsweep as gs
    >>> gs.systems.two_masses().coordinates
    ('x_1', 'x_2')
    """
    chain = np.array([[1.0, -1.0], [-1.0, 2.0]])
    return System(
        mass=np.eye(2),
        damping=0.03 * chain,
        stiffness=chain,
        contacts={"stop": [1.0, 0.0]},
        forcing=[Harmonic(amplitude=[0.0, 0.1])],
        coordinates=("x_1", "x_2"),
        units={"x_1": "1", "x_2": "1"},
    )


def two_masses_law() -> Piecewise:
    """Return the one-sided stop of `two_masses`, ``100 (x - 1)`` beyond 1; `K_ratio` is 0.

    Examples
    --------
    >>> import gapsweep as gs
    >>> gs.systems.two_masses_law().K_c
    100.0
    """
    return Piecewise(100.0, Gap(1.0, 1.0), K_ratio=0.0)


def gear_pair(
    *,
    zeta: float = 0.05,
    mean_load: float = 0.1,
    errors: tuple[float, ...] = (0.01, 0.004, 0.002),
    depths: tuple[float, ...] = (-0.2, -0.1, -0.05),
) -> System:
    """Return a spur gear pair with backlash and periodic mesh stiffness.

    Without dimensions; x is the transmission error along the line of action, in half backlashes::

        x'' + 2 zeta x' + (1 + sum depths_k cos(k W t)) F(x)
            = mean_load + sum errors_k (k W)² cos(k W t),       W = 2 pi omega

    The mesh frequency is the `omega` of `gapsweep.simulate`; the source's range of W is about 0.4
    to 2.

    Parameters
    ----------
    zeta : float
        Damping ratio [-], ``>= 0``.
    mean_load : float
        Mean transmitted load [-].
    errors, depths : tuple of float
        Harmonics 1, 2, ... of the static transmission error and of the mesh stiffness [-].

    Notes
    -----
    A. Kahraman and R. Singh, *J. Sound Vib.* 146 (1991) 135-156; the values are those of public
    code of the Fraunhofer SCAI on damage detection, with initial state x = 0, v = 0.

    Raises
    ------
    ModelError
        If an argument is out of range.

    Examples
    --------
    >>> import gapsweep as gs
    >>> gs.systems.gear_pair(mean_load=0.2)
    <gapsweep.System: coordinates x, contacts mesh>
    """
    loads = [Harmonic(amplitude=[checked("mean_load", mean_load)], k=0)]
    for k, error in enumerate(errors, 1):
        loads.append(Harmonic(amplitude=[checked("errors", error)], k=k, power=2))
    return System(
        mass=[[1.0]],
        damping=[[2.0 * checked("zeta", zeta, low=0.0)]],
        stiffness=[[0.0]],
        contacts={"mesh": [1.0]},
        forcing=loads,
        modulation={"mesh": [Modulation(depth=depth, k=k) for k, depth in enumerate(depths, 1)]},
        coordinates=("x",),
        units={"x": "1"},
    )


def gear_pair_law() -> Piecewise:
    """Return the contact law of `gear_pair`: mean mesh stiffness 1 beyond the backlash.

    Examples
    --------
    >>> import gapsweep as gs
    >>> gs.systems.gear_pair_law().gap
    Gap(j_1=1.0, j_2=1.0)
    """
    return Piecewise(1.0, Gap(1.0, 1.0))


def soft_impact_oscillator(zeta: float = 0.01, load: float = 0.9 * 0.8**2 / 1.26) -> System:
    """Return a harmonically forced mass on a spring, with a second spring behind a gap.

    Without dimensions, in gaps and natural frequencies::

        x'' + 2 zeta x' + x + F(x) = load cos(2 pi omega t)

    Parameters
    ----------
    zeta : float
        Damping ratio [-], ``>= 0``.
    load : float
        Forcing amplitude [-]. The default is that of a base motion of 0.9 mm with a gap of 1.26 mm
        at 2 pi omega = 0.8; as in the source it does not depend on omega.

    Notes
    -----
    The rig: J. Ing, E. Pavlovskaia, M. Wiercigroch, S. Banerjee, *Phil. Trans. R. Soc. A* 366
    (2008) 679-704. The values (zeta 0.01, stiffness ratio 29, 2 pi omega = 0.8): the demonstration
    of the PWSDDE-cont code, doi:10.1016/j.cnsns.2019.105095, without its delayed feedback.

    Raises
    ------
    ModelError
        If an argument is out of range.

    Examples
    --------
    >>> import gapsweep as gs
    >>> gs.systems.soft_impact_oscillator(zeta=0.02)
    <gapsweep.System: coordinates x, contacts stop>
    """
    return System(
        mass=[[1.0]],
        damping=[[2.0 * checked("zeta", zeta, low=0.0)]],
        stiffness=[[1.0]],
        contacts={"stop": [1.0]},
        forcing=[Harmonic(amplitude=[checked("load", load)])],
        coordinates=("x",),
        units={"x": "1"},
    )


def soft_impact_oscillator_law(ratio: float = 29.0) -> Piecewise:
    """Return the second spring of `soft_impact_oscillator`, ``ratio (x - 1)`` beyond 1.

    Parameters
    ----------
    ratio : float
        Stiffness of the second spring over the stiffness of the first [-], ``>= 0``.

    Examples
    --------
    >>> import gapsweep as gs
    >>> gs.systems.soft_impact_oscillator_law(ratio=10.0).K_c
    10.0
    """
    return Piecewise(checked("ratio", ratio, low=0.0), Gap(1.0, 1.0), K_ratio=0.0)
