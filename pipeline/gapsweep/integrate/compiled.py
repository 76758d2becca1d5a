"""The compiled engine: the exact law by Taylor series, all others by Runge–Kutta, in lanes."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numba import float64, njit
from numba.core.errors import NumbaError
from numpy.typing import NDArray

from gapsweep.errors import ModelError
from gapsweep.integrate.motion import Events, Motions, Sampler
from gapsweep.integrate.problem import Integrate, Models, Problems, Solver
from gapsweep.integrate.runge_kutta import lanes, representations, smooth
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
Mask = NDArray[np.bool_]


def prepared(models: Models, solver: Solver) -> Integrate:
    """Integration of models; each result is the same to the last bit in any company."""
    return (_exact if _by_taylor(models.laws[0], solver) else _smooth)(models, solver)


def _by_taylor(law: ContactLaw, solver: Solver) -> bool:
    located = isinstance(law, Piecewise) and law.located
    return located and solver.controller == "native" and not solver.restart


def _column(objects: Sequence[Any], name: str) -> Array:
    return np.array([getattr(each, name) for each in objects])


def _oscillator_arrays(models: Models) -> dict[str, Any]:
    names = ("zeta", "omega_n", "mass", "alpha", "forcing")
    return {name: _column(models.oscillators, name) for name in names} | {"omega": models.omega}


def _gap_arrays(laws: Sequence[Any]) -> dict[str, Any]:
    gaps = [law.gap for law in laws]
    return {"K_c": _column(laws, "K_c"), "j_1": _column(gaps, "j_1"), "j_2": _column(gaps, "j_2")}


def _given(problems: Problems) -> dict[str, Any]:
    """Arguments that both kernels take."""
    effort = problems.t_end - problems.t_0 if problems.effort is None else problems.effort
    return {
        "which": problems.which,
        "x_0": problems.x_0,
        "v_0": problems.v_0,
        "t_0": problems.t_0,
        "t_end": problems.t_end,
        "record_from": problems.record_from,
        "queue": np.argsort(-effort, kind="stable"),
        "section_only": problems.section_only,
        "tangent": problems.tangent,
        "dense_output": problems.dense_output,
    }


def _exact(models: Models, solver: Solver) -> Integrate:
    scenes = exact.scenes(
        **_gap_arrays(models.laws),
        **_oscillator_arrays(models),
        rtol=solver.rtol,
        atol=solver.atol,
    )

    def integrate(problems: Problems) -> Motions:
        run = exact.run(scenes, **_given(problems))

        def events() -> Events:
            point, kind, t, x, v = run.log.T
            # The kinds are numbered so: extrema, the section, then contacts.
            masks = kind < record.SECTION, kind == record.SECTION, kind > record.SECTION
            return _events(len(problems), point, t, x, v, *masks)

        def sampler(i: int) -> Sampler:
            return lambda t: tuple(part[0] for part in run.sample(t, i))

        return _motions(run, events, sampler, run.monodromy)

    return integrate


def _smooth(models: Models, solver: Solver) -> Integrate:
    scenes = smooth.scenes(
        _kernel_law(models.laws, restart=solver.restart),
        **_oscillator_arrays(models),
        rtol=solver.rtol,
        atol=solver.atol,
        controller=solver.controller,
    )

    def integrate(problems: Problems) -> Motions:
        try:
            run = smooth.run(scenes, **_given(problems), contacts=problems.contacts)
        except NumbaError as error:
            reason = _why_not_compiled(models.laws[0])
            if reason is None:  # not the user's fault
                raise
            raise ModelError(
                f"{models.laws[0]}: numba cannot compile it ({reason}); use arithmetic and math "
                "functions only, or engine='scipy'"
            ) from error

        def events() -> Events:
            kind, point, t, x, v, *_ = run.records.T
            masks = (kind == each for each in (lanes.EXTREMUM, lanes.SECTION, lanes.CONTACT))
            return _events(len(problems), point, t, x, v, *masks)

        def sampler(i: int) -> Sampler:
            return lambda t: run.sample(t, i)

        return _motions(run, events, sampler, run.tangent if problems.tangent else None)

    return integrate


def _why_not_compiled(law: ContactLaw) -> str | None:
    """What numba says of a user's function alone; None if it can compile it, or the law is ours."""
    if not isinstance(law, UserLaw):
        return None
    try:
        njit(getattr(law.function, "py_func", law.function)).compile((float64,))
    except NumbaError as error:
        return str(error).strip().splitlines()[0]
    return None


def _events(
    n: int, point: Array, t: Array, x: Array, v: Array, extrema: Mask, section: Mask, contacts: Mask
) -> Events:
    """Events of n motions from the columns of a record sorted by motion, and masks of its rows."""
    number = point.astype(np.int64)
    return Events(
        t_extrema=t[extrema],
        extrema=x[extrema],
        t_contacts=t[contacts],
        section=np.stack((x[section], v[section]), axis=1),
        n_extrema=np.bincount(number[extrema], minlength=n),
        n_contacts=np.bincount(number[contacts], minlength=n),
        n_section=np.bincount(number[section], minlength=n),
    )


def _motions(
    run: Any,
    events: Callable[[], Events],
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
        reach=run.reach,
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
