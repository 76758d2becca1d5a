"""Warnings of numbers that are probably in another unit or have the wrong sign.

The rules are ratios: a machine may be in nanometres, or have no units.
"""

import math
import sys
import warnings
from collections.abc import Iterable, Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gapsweep.model.contact import ContactLaw
from gapsweep.model.oscillator import Oscillator, called_as
from gapsweep.model.system import System, first_order
from gapsweep.model.table import ForceTable
from gapsweep.model.user_law import UserLaw

Array = NDArray[np.float64]

_FAST, _SOFT = 30.0, 1e-3  # times the natural frequency, and the stiffness of the spring
_FAR = 10.0  # times the amplitude of the linear resonance
_GRADED = np.geomspace(1e-4, 1.0, 60)  # distances from a wall, in gap widths
_OWN = UserLaw, ForceTable  # their K_c is no force
# study.run(), gs.risk() and checks of arguments
_BETWEEN = "gapsweep.study.study", "gapsweep.pipeline", called_as.__module__


def doubts(
    models: Sequence[Oscillator | System],
    laws: Sequence[Sequence[ContactLaw]],
    omega: Any,
    starts: Array,
) -> Iterator[str]:
    """Warnings of a call or a study, one sentence each; rules compare extremes over all cases.

    All models have the same contacts, and each entry of `laws` one law a contact; `omega` are
    frequencies [Hz], `starts` initial states, one a row.
    """
    first = models[0]
    zeta = max((each.zeta for each in models if isinstance(each, Oscillator)), default=0.0)
    if zeta >= 1.0:
        yield (f"zeta = {zeta:g}: the oscillator is overdamped; zeta is a ratio, and 0.02 is 2 %")
    natural = max(each.fastest if each.is_held else math.inf for each in models)
    highest = np.max(omega, initial=0.0)
    if 0.0 < _FAST * natural < highest:
        yield (
            f"omega = {highest:g} Hz: more than {_FAST:g} times the natural frequency "
            f"{natural:.3g} Hz; frequencies are in hertz, not in rad/s"
        )
    linear = [_linear(each, starts) for each in models]
    for i, name in enumerate(first.contacts):
        spring = min(springs[i] for springs, _ in linear)
        reach = max(reaches[i] for _, reaches in linear)
        here = [each[i] for each in laws]
        K_c = max((law.K_c for law in here if not isinstance(law, _OWN)), default=0.0)
        wall = min(wall for law in here for wall in _walls(law))
        at, unit = (f" at contact {name!r}", "") if isinstance(first, System) else ("", " m")
        if 0.0 < K_c < _SOFT * spring:
            yield (
                f"K_c = {K_c:g}{at}: less than {_SOFT:g} of the stiffness of the machine there, "
                f"{spring:.3g}; both are in N/m"
            )
        if 0.0 < _FAR * reach < wall < math.inf:
            yield (
                f"gap = {wall:g}{unit}{at}: more than {_FAR:g} times the amplitude of the linear "
                f"resonance, {reach:.2g}{unit}; gaps are in metres, as coordinates are"
            )
    distinct = list({repr(law): law for each in laws for law in each}.values())
    for law in distinct:
        if isinstance(law, ForceTable):
            yield from _of_table(law)
    yield from _of_layers([law for law in distinct if law.is_sharpened and law.K_c], models)


def warn_of(found: Iterable[str]) -> None:
    """Issue one `UserWarning` with all warnings of a user's call; none for calls in the package."""
    level = 2
    while (caller := sys._getframe(level).f_globals.get("__name__", "")) in _BETWEEN:
        level += 1
    if not str(caller).startswith("gapsweep.") and (text := "; ".join(found)):
        warnings.warn(text, stacklevel=level + 1)


def _walls(law: ContactLaw) -> Iterator[float]:
    """Distances of a law's walls [m]; for a table at least those of its points next to zero."""
    yield math.inf
    if isinstance(law, ForceTable):
        x = np.array(law.x)
        yield max(law.gap.j_2, x[x > 0.0].min(initial=math.inf))
        yield max(law.gap.j_1, -x[x < 0.0].max(initial=-math.inf))
    elif law.K_c or isinstance(law, UserLaw):
        yield law.gap.j_2
        if law.K_ratio:
            yield law.gap.j_1


def _linear(model: Oscillator | System, starts: Array) -> tuple[Array, Array]:
    """Stiffness at each contact, and the largest displacement there without contacts [m].

    The displacement adds resonance, mean loads and initial states; it is infinite if the model is
    not forced or not damped, a coordinate is free or a spring softens.
    """
    along = np.reshape(model.directions, (-1, model.n))
    none = np.zeros(len(along)), np.full(len(along), math.inf)
    if isinstance(model, Oscillator):  # in closed form, as calls have thousands of them
        spring = model.mass * model.omega_n_rad**2
        forced = abs(model.at(model.omega_n).forcing)
        if not (spring and model.damping_ratio and forced) or model.alpha < 0.0:
            return none
        load = forced * max(1.0, 0.5 / model.damping_ratio) + abs(model.mean_load)
        return np.array([spring]), load / spring + _from(starts, along, model)
    if model.n_lags or not model.is_held or any(cubic.alpha < 0.0 for cubic in model.cubic):
        return none
    own = np.abs(np.linalg.eigvals(first_order(model)))
    # Not exactly at resonance, where an undamped system has no inverse.
    rates = (1.0 + 1e-9) * np.array([0.0, *own, 1e3 * own.max()])[:, None, None]
    dynamic = model.stiffness - rates**2 * model.mass + 1j * rates * model.damping
    moved = along @ np.linalg.inv(dynamic)
    sizes = [np.abs(moved @ one.amplitude) * one.growth(rates[:, :, 0]) for one in model.forcing]
    reach = np.sum([x for x, one in zip(sizes, model.forcing, strict=True) if one.k], axis=0)
    mean = np.sum([x[0] for x, one in zip(sizes, model.forcing, strict=True) if not one.k], axis=0)
    springs = 1.0 / np.abs(np.sum(moved[0].real * along, axis=1))
    if not np.any(reach):
        return springs, none[1]
    return springs, reach.max(axis=0) + mean + _from(starts, along, model)


def _from(starts: Array, along: Array, model: Oscillator | System) -> Array:
    """Upper bound of the displacement at each contact due to the initial states [m]."""
    n, rate = model.n, 2.0 * math.pi * model.slowest
    x, v = np.abs(starts[:, :n] @ along.T), np.abs(starts[:, n : 2 * n] @ along.T) / rate
    found: Array = x.max(axis=0, initial=0.0) + v.max(axis=0, initial=0.0)
    return found


def _largest_load(model: Oscillator | System) -> float:
    """Largest amplitude of a load on a coordinate at the lowest natural frequency [N]."""
    if isinstance(model, Oscillator):
        return abs(model.at(model.omega_n).forcing)
    rate = 2.0 * math.pi * model.slowest
    loads = [one.growth(rate) * np.abs(one.amplitude).max() for one in model.forcing if one.k]
    return max(map(float, loads), default=0.0)


def _of_layers(laws: Sequence[ContactLaw], models: Sequence[Oscillator | System]) -> Iterator[str]:
    """Warnings of smooth laws without clearance, and with too large a force between the walls."""
    forcing = max(map(_largest_load, models))
    loud: dict[str, float] = {}
    wide = {}
    for law in laws:
        name = "gamma" if hasattr(law, "gamma") else "epsilon"
        said, half = f"{name} = {1.0 / law.layer:g} /m", 0.5 * law.gap.width
        if law.layer > half > 0.0:
            wide[said, half] = (
                f"{said}: the force rises over 1/{name} = {law.layer:.2g} m, more than half the "
                f"gap, {half:.2g} m: there is no clearance; write {name} = {10.0 / half:.0e} or "
                "more"
            )
        elif 0.0 < half < math.inf:
            loud[said] = min(loud.get(said, math.inf), _in_gap_force(law))
    yield from wide.values()
    for said, force in loud.items():
        if force > forcing > 0.0:
            yield (
                f"{said}: between the walls the force is up to {force:.2g} N, more than the "
                f"forcing, {forcing:.2g} N; gs.static_error(law, forcing={forcing:g}).needed is "
                "a parameter to use"
            )


def _in_gap_force(law: ContactLaw) -> float:
    """Largest force between the walls [N], from points graded towards both walls."""
    steps = law.gap.width * _GRADED
    return float(np.abs(law.force(np.append(steps - law.gap.j_1, law.gap.j_2 - steps))).max())


def _of_table(table: ForceTable) -> Iterator[str]:
    """A warning of a force table with the wrong sign, or with noise around zero."""
    force = np.array(table.F)
    for x, F in zip(table.valid_range, force[[0, -1]], strict=True):
        if x * F < 0.0:
            yield (
                f"force table: F = {F:g} N at x = {x:g} m pulls outwards; F is the restoring force "
                "and has the sign of x: write gs.ForceTable(x, -F)"
            )
            return
    (changes,) = np.nonzero(force[1:] * force[:-1] < 0.0)
    if changes.size > 2:  # a restoring force changes its sign at most once
        noise = 1.05 * np.abs(force[changes[0] + 1 : changes[-1] + 1]).max()
        yield (
            f"the force changes its sign {changes.size} times near x = 0: measurement noise acts "
            f"as stiffness there; write gs.ForceTable(x, F, noise={noise:.2g}) to set it to zero"
        )
