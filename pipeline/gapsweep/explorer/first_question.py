"""The question with which the page begins, of a model or of a study."""

import inspect
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields, replace
from functools import partial
from typing import Any

import numpy as np

from gapsweep.errors import ModelError
from gapsweep.explorer.question import DIALS, WALLS, Question, SliderModel, labels
from gapsweep.integrate.problem import Model
from gapsweep.integrate.simulate import AnyLaw
from gapsweep.model.contact import OF_LABELS, OF_WALLS, ContactLaw, Piecewise
from gapsweep.model.labels import EXACT, Representation
from gapsweep.model.oscillator import Gap, Oscillator, is_number
from gapsweep.model.parameters import made_model
from gapsweep.model.system import System
from gapsweep.model.systems import paper_oscillator
from gapsweep.study.study import Study

DEFAULT_APPROXIMATIONS = ("tanh-1e4",)
# First frequency of the page in natural frequencies: above resonance, where contacts matter.
_LOOKED_AT = 1.8
_MODES = 20.0  # largest natural frequency in the first response, over the smallest
_OSCILLATOR = tuple(name for name in DIALS if name in {each.name for each in fields(Oscillator)})


def _machine(
    model: Any,
    walls: Mapping[str, Mapping[str, str | float]],
    widest: float,
    laws: Mapping[str, str] | None = None,
    exact: Mapping[str, Piecewise] | None = None,
) -> SliderModel:
    """The machine of a model, or of a function that returns it for keywords with defaults.

    `widest` is the distance of a wall; those of a system decide the power of ten that is shown.
    """
    several = laws or {}, exact or {}
    if isinstance(model, Oscillator):
        numbers_of = {name: getattr(model, name) for name in _OSCILLATOR}
        return SliderModel(lambda values: replace(model, **values), numbers_of, walls, *several)
    factor = 10.0 ** (3 * round(math.log10(widest) / 3)) if widest else 1.0
    if isinstance(model, System):
        return SliderModel(lambda _: model, {}, walls, *several, factor)
    made = partial(made_model, model)
    return SliderModel(made, _defaults(model), walls, *several, factor)


def _defaults(function: Any) -> dict[str, float]:
    """The arguments of a function that are numbers, and their defaults."""
    try:
        several = inspect.signature(function).parameters.values()
    except (TypeError, ValueError):
        raise ModelError(
            f"oscillator = {function!r:.80}: must be a gapsweep.Oscillator, a gapsweep.System, or "
            "a function that returns one for keywords"
        ) from None
    for one in several:
        if one.default is one.empty:
            raise ModelError(
                f"{one.name}: has no default; write functools.partial(function, {one.name}=1.0)"
            )
    return {one.name: float(one.default) for one in several if is_number(one.default)}


def of_model(
    oscillator: Model | Callable[..., Model] | None = None,
    law: AnyLaw | None = None,
    *,
    approximations: Sequence[str] = DEFAULT_APPROXIMATIONS,
) -> Question:
    """The initial question of the page for a model and its contact laws.

    Raises `ModelError` if an argument has another type or is out of range.
    """
    typed = [approximations] if isinstance(approximations, str) else approximations
    if not (isinstance(typed, Sequence) and all(isinstance(each, str) for each in typed)):
        raise ModelError(f"approximations = {typed!r:.80}: must be labels, as ['tanh-1e4']")
    model = paper_oscillator() if oscillator is None else oscillator
    example = model
    if not isinstance(example, Oscillator | System):
        example = made_model(example, _defaults(example))
    if not (example.is_forced and example.contacts):
        raise ModelError(f"oscillator = {model!r:.80}: {_NOT_SHOWN}")
    law = Piecewise(K_c=1.4e4, gap=Gap(0.4e-3, 0.4e-3)) if law is None else law
    several = law if isinstance(law, Mapping) else dict.fromkeys(example.contacts, law)
    for one in several.values():
        if not isinstance(one, ContactLaw):
            raise ModelError(f"law = {one!r:.80}: must be a contact law, as gapsweep.Piecewise")
    if set(several) != set(example.contacts):
        raise ModelError(f"law: of {list(several)}: must name {list(example.contacts)}")
    is_one = len(set(map(id, several.values()))) == 1
    of_laws = {contact: _numbers_of(several[contact]) for contact in example.contacts}
    walls: dict[str, dict[str, str | float]] = {contact: {} for contact in of_laws}
    if approximations is DEFAULT_APPROXIMATIONS and not all("K_c" in of for of in of_laws.values()):
        typed = []  # rigid walls have no stiffness for it
    values: dict[str, float] = {"omega": _LOOKED_AT * example.slowest}
    for contact, of_law in of_laws.items():
        for name, value in of_law.items():
            slider = name if is_one else f"{name} of {contact}"
            is_wall = value < math.inf
            walls[contact][name] = slider if is_wall else value
            values |= {slider: value} if is_wall else {}
    exact = {k: one for k, one in several.items() if isinstance(one, Piecewise) and one.located}
    widest = max(one.gap.size for one in several.values())
    machine = _machine(model, walls, widest, exact=exact)
    values |= machine.parameters
    low, fastest = example.slowest, min(example.fastest, _MODES * example.slowest)
    return Question(
        machine=machine,
        values=tuple(values[name] for name in machine.names),
        approximations=labels(" ".join(typed)),
        band=(0.4 * low, max(3.0 * low, 1.5 * fastest)),
    )


def _numbers_of(law: ContactLaw) -> dict[str, float]:
    """The numbers of a contact law that have sliders, by name, in SI units."""
    exact = law if isinstance(law, Piecewise) else law.exact
    own = {each.name for each in fields(exact) if each.init}
    places = {"j_1": law.gap.j_1, "j_2": law.gap.j_2}
    return places | {name: getattr(exact, name) for name in WALLS if name in own}


_NOT_SHOWN = (
    "explore needs a forcing and a contact, since its figures are over the forcing frequency; use "
    "gapsweep.respond, gapsweep.map and gapsweep.basins"
)


def refuse_code(tables: Mapping[str, Any], source: object) -> None:
    """Raise a `ModelError` for the tables of a run of systems that user code made.

    The code is not imported, since a folder of results may come from elsewhere.
    """
    function = (tables.get("system") or {}).get("function") or ""
    if ":" in function:
        raise ModelError(
            f"{source}: the system is made by {function!r}; no code named in a run is executed: "
            "explore the study file"
        )


def of_study(study: Study) -> tuple[Question, dict[str, tuple[float, float]]]:
    """The initial question of the page for a study, and its swept ranges.

    Raises `ModelError` if a value of the study is out of the range of the page.
    """
    grid, spec, example = study.grid, study.spec, study.model.default
    if not (example.is_forced and example.contacts):
        raise ModelError(f"{study.source}: {_NOT_SHOWN}")
    gaps = grid.gaps if {"gap", "j_1"} & grid.axes.keys() else ()
    machine = _machine_of(study, gaps)
    ranges = {
        name: (min(axis), max(axis)) for name, axis in grid.axes.items() if name in machine.names
    }
    for name in {"j_1", "j_2"}.intersection(machine.names) if gaps else ():
        walls = [getattr(gap, name) for gap in gaps]
        ranges[name] = min(walls), max(walls)
    band = ranges.pop("omega")
    is_one = band[0] == band[1]
    if is_one:
        band = 0.5 * band[0], 2.0 * band[1]
    # The first requested cell: in a union of blocks, other cells may be no points.
    first = np.argwhere(grid.requested)[0]
    point = {name: axis[k] for (name, axis), k in zip(grid.axes.items(), first, strict=True)}
    values: dict[str, Any] = {**OF_WALLS, "j_1": 0.0, "j_2": 0.0, **spec.model, **point}
    if "gap" in point:
        values |= {"j_1": point["gap"].j_1, "j_2": point["gap"].j_2}
    if not is_one:
        values["omega"] = min(max(_LOOKED_AT * example.slowest, band[0]), band[1])
    ours = [law for law in _plain(grid.representations) if not law.is_own]
    others = [law for law in ours if law != EXACT and not law.is_auto]
    question = Question(
        machine=machine,
        values=tuple(float(values[name]) for name in machine.names),
        band=band,
        approximations=tuple(others[:1]),
        fit_range=spec.approximation.range,
    )
    return question, ranges


def _machine_of(study: Study, gaps: Sequence[Gap]) -> SliderModel:
    """The model of a study; numbers of a contact in [contact] have no slider."""
    walls: dict[str, dict[str, str | float]] = {}
    laws, widths = {}, [gap.size for gap in gaps]
    places = dict[str, str | float]()
    for name in ("j_1", "j_2"):
        is_absent = [getattr(gap, name) == math.inf for gap in gaps]
        if any(is_absent) and not all(is_absent):
            raise ModelError(
                f"{study.source}: {name} = inf next to other values: explore draws machines with "
                "equal walls; give a study of either"
            )
        places |= {name: math.inf} if any(is_absent) else {}
    for contact in study.model.contacts:
        table = study.spec.contact.get(contact)
        own = {} if table is None else table.model_dump(exclude_none=True)
        if law := own.pop("representation", None):
            laws[contact] = Representation(law).law
            if laws[contact].is_own:
                raise ModelError(
                    f"{study.source}: contact {contact}: {law}: user laws are not computed here"
                )
        if "gap" in own:
            own["j_1"], own["j_2"] = own.pop("gap")
            widths.append(Gap(own["j_1"], own["j_2"]).size)
        # A contact with a separate law has the damping and preload that the study gives it, if any.
        of_contact = [laws[contact]] if contact in laws else _plain(study.grid.representations)
        names = [
            name
            for name in WALLS
            if name not in OF_LABELS or any(law.takes(name) for law in of_contact)
        ]
        others = () if contact not in laws else ("damping", "preload")
        names = [name for name in names if name in own or name not in others]
        walls[contact] = {name: own.get(name, places.get(name, name)) for name in names}
    model = study.model.along(tuple(study.spec.model), {}) or study.model.default
    pulling = Piecewise(0.0, Gap(0.0, 0.0), pulls=True)  # with the numbers of the sliders
    exact = dict.fromkeys(walls, pulling) if study.spec.study.pulls else {}
    return _machine(model, walls, max(widths, default=0.0), laws, exact)


def not_computed(study: Study) -> str:
    """A note that the page does not compute user-defined laws; empty if there are none."""
    own = [law for law in _plain(study.grid.representations) if law.is_own]
    if not own:
        return ""
    return (
        f"Not computed here: the user-defined {', '.join(own)}. Squares: stored results; black: "
        "the piecewise-linear law, with K_c and the gap of the sliders."
    )


def _plain(representations: Sequence[Representation]) -> list[Representation]:
    """Distinct representations without their protocols."""
    return list(dict.fromkeys(one.law for one in representations))
