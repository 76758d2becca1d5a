"""The compiled engine: Taylor or Runge–Kutta steps, by the laws of the contacts."""

from operator import attrgetter
from typing import Any

import numpy as np
from numba.core.errors import NumbaError
from numpy.typing import NDArray

from gapsweep.errors import ModelError
from gapsweep.integrate.lanes.columns import has_same_walls, with_columns
from gapsweep.integrate.lanes.law_rows import with_losses
from gapsweep.integrate.lanes.method import Method
from gapsweep.integrate.lanes.scene_table import SceneTable, scenes
from gapsweep.integrate.lanes.system_rows import Walls, system_scenes
from gapsweep.integrate.motions import Events, Motions
from gapsweep.integrate.overlap import apart
from gapsweep.integrate.problem import Integrate, Models, Problems, Shifts, Solver
from gapsweep.integrate.runge_kutta import representations
from gapsweep.integrate.runge_kutta.smooth_scenes import runge_kutta_scenes
from gapsweep.integrate.stepping import batch, record
from gapsweep.integrate.taylor.method import Taylor
from gapsweep.integrate.taylor.smooth_scenes import smooth_scenes
from gapsweep.model.contact import Piecewise
from gapsweep.model.laws.arctan import Arctan
from gapsweep.model.laws.fitted import Fitted
from gapsweep.model.laws.logarctan import LogArctan
from gapsweep.model.laws.tanh import Tanh
from gapsweep.model.oscillator import CLASSIC, Oscillator
from gapsweep.model.table import ForceTable
from gapsweep.model.user_law import UserLaw

Array = NDArray[np.float64]

# Largest relative tolerance at which steps cross overlapping layers of tanh, too.
_THICK_LAYERS_UP_TO = 1e-5
_LONGEST = 200  # characters of numba's message
_IS_ZERO = "one of them is 0 and adds a load, a spring or a wall; give it a small value"


@apart
def prepared(models: Models, solver: Solver, shifts: Shifts | None = None) -> Integrate:
    """Return the integrator of some models; no result depends on the other rows of a call.

    With `shifts`, motions of the first n models with a tangent are differentiated by parameters
    too; `models` then has the rows that `Shifts` describes.
    """
    if shifts is not None:
        _check_columns(models, solver, shifts)
    is_taylor = _by_taylor(models, solver)
    scenes = _scenes(models, solver, is_taylor)
    method: Method = Taylor()
    is_located = is_taylor and (scenes.at.is_tanh or _is_exact(models))
    mass = models.of_systems(attrgetter("mass")) if _is_oscillator(models) else None
    if shifts is not None:
        scenes = _with_columns(scenes, shifts)
    if not is_located:
        laws = [_kernel_law(models, contact) for contact in range(len(models.laws[0]))]
        mass = np.ones(len(models)) if mass is None else mass
        if is_taylor:
            rows = [law.rows(mass, len(models)) for law in laws]
            pushes = np.abs(models.of_laws(lambda law: law.force(0.0).item())).T / mass
            scenes = smooth_scenes(scenes, [law.kind[:3] for law in laws], rows, pushes)
        else:
            scenes, method = runge_kutta_scenes(scenes, laws, mass, solver)

    def integrate(problems: Problems) -> Motions:
        records_contacts = problems.contacts or (problems.contact_time and not is_located)
        run = batch.run(scenes, method, problems, _queue(problems), contacts=records_contacts)

        def events() -> Events:
            return _events(len(problems), run)

        n_steps = run.n_steps
        return Motions(
            t=run.t_sampled if problems.dense_output else run.t,
            state=run.state,
            status=run.status,
            n_contacts=run.n_contacts,
            n_steps=n_steps,
            n_rejected=run.n_rejected,
            nfev=n_steps if is_taylor else run.nfev,
            reach=run.reach,
            events=events,
            sampler=run.sample,
            monodromy=run.monodromy,
            columns=run.columns,
            contact_time=run.contact_time if problems.contact_time and is_located else None,
            contact_loss=run.contact_loss,
            contact_force=_forces(run.contact_force, mass, problems.which),
        )

    return integrate


def _forces(found: Array | None, mass: Array | None, which: NDArray[np.intp]) -> Array | None:
    """Return largest forces [N], of oscillators from those per unit mass."""
    return found if found is None or mass is None else found * mass[which, None]


def _check_columns(models: Models, solver: Solver, shifts: Shifts) -> None:
    """Raise a `ModelError` if motions of the models have no parameter columns."""
    if not _is_exact(models):
        raise ModelError(
            f"law = {models.laws[0][0]}: gradients need located contacts, as "
            "gs.Piecewise(1.4e4, gs.Gap(4e-4, 4e-4))"
        )
    if solver.runge_kutta_setting:
        raise ModelError(f"{solver.runge_kutta_setting}: gradients need Taylor steps; leave it out")
    kinds = {tuple(law.losses.kind for law in laws) for laws in models.laws}
    if len(kinds) > 1 or len({system.sizes for system in models.systems}) > 1:
        raise ModelError(f"parameters = {list(shifts.names)}: {_IS_ZERO}")


def _with_columns(scenes: SceneTable, shifts: Shifts) -> SceneTable:
    """Return the table of the first n models with a column for every parameter."""
    if not has_same_walls(scenes, shifts.n):
        raise ModelError(f"parameters = {list(shifts.names)}: {_IS_ZERO}")
    found, is_covered = with_columns(scenes, shifts)
    for name, is_fine in zip(shifts.names, is_covered.tolist(), strict=True):
        if not is_fine:
            raise ModelError(
                f"parameter {name!r}: changes the direction of a contact or of a cubic spring, a "
                "phase, or a load by pieces; gradients cover masses, dampers, springs, walls and "
                "amplitudes of harmonics"
            )
    return found


def _by_taylor(models: Models, solver: Solver) -> bool:
    """Whether the Taylor method integrates the models; refuse models that no method integrates."""
    laws, n_located = models.laws[0], models.n_located
    solver.check_located(n_located, len(laws), is_oscillator=_is_oscillator(models))
    models.check_losses(solver)
    if solver.controller != "native" or (n_located and solver.runge_kutta_setting):
        return not laws
    if _is_exact(models):
        return True
    if models.is_lossy:  # their velocities are in the formulas of Runge-Kutta steps only
        return False
    if _crosses_layers(models, solver):
        return True
    # Measured (decision 50): series of tanh, and of fits at several contacts, cost more than
    # Runge-Kutta steps.
    by_series = (Arctan, LogArctan) if len(laws) > 1 else (Arctan, LogArctan, Fitted)
    return all(isinstance(law, by_series) for law in laws)


def _is_exact(models: Models) -> bool:
    """Whether all contacts are located ones of this package."""
    return all(law.is_located and not isinstance(law, UserLaw) for law in models.laws[0])


def _crosses_layers(models: Models, solver: Solver) -> bool:
    """Whether steps cross the layers of an oscillator's tanh at once where they can."""
    law = models.laws[0][0] if _is_oscillator(models) else None
    if not isinstance(law, Tanh):
        return False
    return law.has_thin_layers or solver.rtol <= _THICK_LAYERS_UP_TO


def _is_oscillator(models: Models) -> bool:
    """Whether the models are oscillators, for which kernels have a layout of one coordinate."""
    return isinstance(models.systems[0], Oscillator)


def _oscillators(models: Models) -> dict[str, Any]:
    *columns, inertial = models.of_systems(attrgetter(*CLASSIC, "inertial_load")).T
    found = dict(zip(CLASSIC, columns, strict=True)) | {"omega": models.omega}
    return found | {"forcing": found["forcing"] + inertial * (2.0 * np.pi * models.omega) ** 2}


def _walls(models: Models) -> dict[str, Any]:
    """Stiffnesses and walls of all contacts, shape (n, n_contacts)."""
    shape = len(models), len(models.laws[0]), 4
    columns = models.of_laws(lambda law: (*law.scale, *law.walls)).reshape(shape)
    stiffness, ratio, low, high = columns.transpose(2, 0, 1)
    return {"K_c": stiffness, "K_ratio": ratio, "j_1": -low, "j_2": high}


def _queue(problems: Problems) -> NDArray[np.intp]:
    """Return the motions that follow no other, the longest ones first."""
    effort = problems.t_end - problems.t_0 if problems.effort is None else problems.effort
    if problems.follows is None:
        return (-effort).argsort(kind="stable")
    heads = np.flatnonzero(~problems.follows)
    return np.asarray(heads[(-np.add.reduceat(effort, heads)).argsort(kind="stable")])


def _scenes(models: Models, solver: Solver, is_taylor: bool) -> SceneTable:
    tolerances: dict[str, Any] = {"rtol": solver.rtol, "atol": models.absolute(solver)}
    walls = _walls(models)
    if _is_oscillator(models):
        of_contact = {name: column[:, 0] for name, column in walls.items()}
        if is_taylor and _crosses_layers(models, solver):
            of_contact["epsilon"] = models.of_laws(attrgetter("epsilon"))[:, 0]
        found = scenes(**of_contact, **_oscillators(models), **tolerances)
    else:
        of_all = models.systems, models.system, Walls(**walls), models.omega
        found = system_scenes(*of_all, **tolerances)
    if not models.is_lossy:
        return found
    losses = np.moveaxis(models.of_laws(attrgetter("losses")), -1, 0)
    damping, never_pulls, chi, by_function, is_rigid, restitution, preload = losses
    mass = models.of_systems(attrgetter("mass"))[:, None] if _is_oscillator(models) else 1.0
    impacts = restitution, models.of_laws(lambda law: law.losses.of_impact)
    is_damped = bool(np.any([damping, chi, by_function, preload]))
    rows = damping / mass, never_pulls > 0.0, chi, is_rigid > 0.0, impacts, preload / mass
    return with_losses(found, *rows, is_damped=is_damped, rtol=solver.rtol)


def _events(n: int, run: batch.Batch) -> Events:
    """Return the `Events` of n motions."""
    turns, contacts, sections = run.turns, run.contacts, run.sections
    n_extrema, n_contacts, n_section = (
        np.bincount(log[:, record.POINT].astype(np.int64), minlength=n)
        if len(log)
        else np.zeros(n, np.int64)
        for log in (turns, contacts, sections)
    )
    return Events(
        t_extrema=turns[:, record.TIME].copy(),
        extrema=turns[:, record.VALUE].copy(),
        extrema_of=turns[:, record.WHICH].astype(np.int64),
        t_contacts=contacts[:, record.TIME].copy(),
        contacts_of=contacts[:, record.WHICH].astype(np.int64),
        t_section=sections[:, record.TIME].copy(),
        section=sections[:, record.STATE :].copy(),
        n_extrema=n_extrema,
        n_section=n_section,
        n_contacts=n_contacts,
    )


def _kernel_law(models: Models, contact: int) -> Any:
    """Return the compiled law of one contact, with the parameters of all rows."""
    law = models.laws[0][contact]

    def column(name: str) -> Array:
        return np.array([getattr(laws[contact], name) for laws in models.laws])[models.law]

    gaps = {name: values[:, contact] for name, values in _walls(models).items()}
    if isinstance(law, Piecewise) and law.located:
        return representations.located(**gaps)
    if law.is_numbers:
        sharpness = column(law.symbol) if law.symbol else np.nan
        return representations.of_numbers(type(law), **gaps, sharpness=sharpness)
    walls = {"j_1": -law.walls[0], "j_2": law.walls[1]}
    match law:
        case Fitted():
            return representations.fitted(type(law), *law.coefficients, law.fit_range, **walls)
        case ForceTable():
            return representations.table(law.x, law.pieces, **walls)
        case UserLaw():
            named = [[*each.values()] for each in column("parameters")]
            try:
                return representations.user(
                    law.function,
                    gaps["j_1"],
                    gaps["j_2"],
                    named,
                    is_of_speed=law.is_of_speed,
                )
            except NumbaError as error:
                raise ModelError(
                    f"{law}: numba cannot compile it ({_reason(error)}); use arithmetic and "
                    "functions of math, write @numba.njit before other functions that it calls, "
                    "or use engine='scipy'"
                ) from None
    raise TypeError(f"no compiled form of {type(law).__name__}")


def _reason(error: NumbaError) -> str:
    """Return the line of numba's error message that states the cause."""
    lines = [line.strip() for line in str(error).splitlines()]
    several = [line for line in lines if line and not line.startswith("Failed in nopython mode")]
    return several[0][:_LONGEST] if several else type(error).__name__
