"""The compiled engine: the exact law by Taylor series, all others by Runge–Kutta, in lanes.

Problems of one kind go to their kernel in one call, whatever their parameters; the results go
back into the order of the problems.
"""

from collections.abc import Callable, Hashable, Sequence
from typing import Any

import numpy as np
from numba.core.errors import NumbaError
from numpy.typing import NDArray

from gapsweep.errors import ModelError
from gapsweep.integrate.motion import Events, Motions, Sampler, merged
from gapsweep.integrate.problem import Problems, Solver
from gapsweep.integrate.runge_kutta import representations, smooth
from gapsweep.integrate.taylor import exact, record
from gapsweep.model.contact import (
    Arctan,
    ContactLaw,
    LogArctan,
    Piecewise,
    Polynomial,
    RationalPolynomial,
    Tanh,
    UserLaw,
)

Array = NDArray[np.float64]


def integrate(problems: Problems, solver: Solver) -> Motions:
    """Integrate every problem; each result is the same to the last bit in any company."""
    parts = []
    for numbers in _kinds(problems.laws, solver):
        some = problems.take(numbers)
        kernel = _exact if _by_taylor(some.laws[0], solver) else _smooth
        parts.append((numbers, kernel(some, solver)))
    return merged(len(problems), parts)


def _by_taylor(law: ContactLaw, solver: Solver) -> bool:
    located = isinstance(law, Piecewise) and law.located
    return located and solver.controller == "native" and not solver.restart


def _kinds(laws: Sequence[ContactLaw], solver: Solver) -> list[list[int]]:
    """Problems that one call of a kernel can take: by law family, fits and users' by law."""
    kinds: dict[Hashable, list[int]] = {}
    for i, law in enumerate(laws):
        parametric = isinstance(law, Piecewise | Tanh | Arctan | LogArctan)
        located = isinstance(law, Piecewise) and law.located
        kinds.setdefault((type(law), located) if parametric else law, []).append(i)
    return list(kinds.values())


def _oscillator_arrays(problems: Problems) -> dict[str, Array]:
    names = ("zeta", "omega_n", "mass", "alpha", "forcing")
    return {name: np.array([getattr(o, name) for o in problems.oscillators]) for name in names}


def _gap_arrays(laws: Sequence[Any]) -> dict[str, Any]:
    return {
        "K_c": np.array([law.K_c for law in laws]),
        "j_1": np.array([law.gap.j_1 for law in laws]),
        "j_2": np.array([law.gap.j_2 for law in laws]),
    }


def _common(problems: Problems, solver: Solver) -> dict[str, Any]:
    """Arguments that both kernels take."""
    return _oscillator_arrays(problems) | {
        "omega": problems.omega,
        "x_0": problems.x_0,
        "v_0": problems.v_0,
        "t_0": problems.t_0,
        "t_end": problems.t_end,
        "record_from": problems.record_from,
        "rtol": solver.rtol,
        "atol": solver.atol,
        "tangent": problems.tangent,
        "dense_output": problems.dense_output,
    }


def _exact(problems: Problems, solver: Solver) -> Motions:
    run = exact.integrate(**_gap_arrays(problems.laws), **_common(problems, solver))

    def events(i: int) -> Events:
        rows = run.events(i)
        # The kinds are numbered so: extrema, the section, then contacts.
        kind = rows[:, 3]
        extrema, section = rows[kind < record.SECTION], rows[kind == record.SECTION]
        contacts = rows[kind > record.SECTION, 0]
        return Events(extrema[:, 0], extrema[:, 1], contacts, section[:, 1:3])

    def sampler(i: int) -> Sampler:
        return lambda t: tuple(part[0] for part in run.sample(t, i))

    return _motions(run, events, sampler, run.monodromy)


def _smooth(problems: Problems, solver: Solver) -> Motions:
    law = _kernel_law(problems.laws, restart=solver.restart)
    try:
        run = smooth.integrate(law, controller=solver.controller, **_common(problems, solver))
    except NumbaError as error:
        reason = str(error).strip().splitlines()[0]
        raise ModelError(
            f"{problems.laws[0]}: numba cannot compile it ({reason}); use arithmetic and math "
            "functions only, or engine='scipy'"
        ) from None

    def events(i: int) -> Events:
        t_extrema, extrema = run.extrema(i)
        return Events(t_extrema, extrema, run.contacts(i)[:, 0], run.section(i)[:, 1:3])

    def sampler(i: int) -> Sampler:
        return lambda t: run.sample(t, i)

    return _motions(run, events, sampler, run.tangent if problems.tangent else None)


def _motions(
    run: Any,
    events: Callable[[int], Events],
    sampler: Callable[[int], Sampler],
    monodromy: Array | None,
) -> Motions:
    return Motions(
        t=run.t,
        x=run.x,
        v=run.v,
        status=run.status,
        n_contacts=run.n_contacts,
        n_steps=run.n_steps,
        n_rejected=run.n_rejected,
        nfev=run.nfev,
        events=events,
        sampler=sampler,
        monodromy=monodromy,
    )


def _kernel_law(laws: Sequence[Any], *, restart: bool) -> Any:
    """The laws of one kind, with their parameters, as the Runge–Kutta kernel takes them."""
    law = laws[0]
    gaps = _gap_arrays(laws)
    match law:
        case Tanh() | Arctan():
            build = representations.tanh if isinstance(law, Tanh) else representations.arctan
            return build(**gaps, epsilon=np.array([each.epsilon for each in laws]))
        case LogArctan():
            return representations.log_arctan(**gaps, gamma=np.array([e.gamma for e in laws]))
        case Piecewise():
            return representations.piecewise(**gaps, restart=restart and law.located)
    walls = {"j_1": law.gap.j_1, "j_2": law.gap.j_2}
    match law:
        case Polynomial():
            return representations.polynomial(law.coefficients[0], law.fit_range, **walls)
        case RationalPolynomial():
            return representations.rational_polynomial(*law.coefficients, law.fit_range, **walls)
        case UserLaw():
            return representations.user(law.function, **walls)
    raise TypeError(f"no compiled form of {type(law).__name__}")
