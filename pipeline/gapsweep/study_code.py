"""Calls of a study's own Python files, which make datasets, verdicts and sections of the report.

xarray and matplotlib are imported by what needs them: a run that finds everything up to date ends
before they would be loaded.
"""

import json
import re
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from types import FunctionType
from typing import TYPE_CHECKING, Any

from gapsweep.errors import StudyError
from gapsweep.study.study import Study
from gapsweep.user_code.load import inner_name, load_module, user_errors
from gapsweep.user_code.snapshot import Snapshot

if TYPE_CHECKING:
    import xarray as xr

    from gapsweep.analysis.claims import Claim, Run


def own_datasets(study: Study) -> dict[str, Callable[[Study], Any]]:
    """The functions in ``DATASETS`` of a study's claims module, by the name of their files.

    Raises `StudyError` if the module cannot be imported, or its ``DATASETS`` is no dict of
    functions.
    """
    code = study.claims_code
    if code is None:
        return {}
    found = getattr(load_module(code), "DATASETS", {})
    if not isinstance(found, Mapping):
        example = "DATASETS = {'name': function}"
        raise StudyError(f"{code.path}: DATASETS: must be a dict of functions, as {example}")
    for name, function in found.items():
        where = f"{code.path}: DATASETS: {name!r}"
        if not isinstance(name, str) or not re.fullmatch("[a-z_]+", name):
            raise StudyError(f"{where}: names must have the letters a to z and _ only")
        if not callable(function):
            raise StudyError(f"{where}: must be a function of the study, not {function!r:.40}")
    return {f"{name}.nc": function for name, function in found.items()}


def dataset_key(study: Study, function: Any) -> str:
    """Key of the code of a function that makes a dataset.

    A function of another module depends on that module only: the rest of the code may be edited.
    Everything else, such as a closure, depends on all of the code.
    """
    assert study.claims_code is not None, "datasets come from there"
    code, name = study.claims_code, getattr(function, "__qualname__", "")
    module = sys.modules.get(getattr(function, "__module__", None) or "")
    if isinstance(function, FunctionType) and vars(module).get(name) is function:
        assert module is not None
        if (inner := inner_name(module.__name__, code)) is not None:
            return f"{name} {code.part(inner).key}"
    return code.key


def check_modules(study: Study) -> None:
    """Import the code that a study names, to report its errors before the computation.

    Raises `StudyError` if it cannot be imported, or lacks claims or the function ``sections``.
    """
    own_datasets(study)
    if study.claims_code is not None:
        _claims_in(study.claims_code)
    if study.report_code is not None:
        _sections_in(study.report_code)


def make_dataset(study: Study, file: str, function: Callable[[Study], Any]) -> "xr.Dataset":
    """The dataset that a function of the study's claims module returns, with its attributes."""
    import xarray as xr

    assert study.claims_code is not None, "datasets come from there"
    with user_errors(study.claims_code.path, file, function):
        made = function(study)
        if not isinstance(made, xr.Dataset):
            raise TypeError(
                f"its function must return an xarray.Dataset, not a {type(made).__name__}"
            )
    return made.assign_attrs(title=study.title, study=study.name, study_json=study.json)


def decide_claims(study: Study, datasets: Mapping[str, "xr.Dataset"]) -> dict[str, Any]:
    """The verdicts on a study's claims, from the datasets of its run by their names."""
    from gapsweep.analysis.claims import Run, counted

    code = study.claims_code
    assert code is not None, "the stage does not apply without claims"
    run, decided = Run(datasets), []
    for claim in _claims_in(code):
        with user_errors(code.path, f"claim {claim.id}", claim.find):
            decided.append(claim.decided(run))
    return _as_json(study, "claims", code.path, counted(decided))


def draw_sections(study: Study, datasets: Mapping[str, "xr.Dataset"]) -> dict[str, Any]:
    """A study's own sections of the report, from the datasets of its run by their names."""
    from gapsweep.analysis.claims import Run
    from gapsweep.report.parts import rendered

    code = study.report_code
    assert code is not None, "the stage does not apply without sections"
    sections = _sections_in(code)
    with user_errors(code.path, "sections", sections):
        # Names that no section of gapsweep has.
        parts = rendered(sections(Run(datasets)))
        parts = [part | {"anchor": f"own-{part['anchor']}"} for part in parts]
    return _as_json(study, "report", code.path, {"sections": parts})


def _as_json(study: Study, table: str, path: Path, found: dict[str, Any]) -> dict[str, Any]:
    """Results of a user module with the names of study and file; StudyError if not JSON."""
    with user_errors(path, "claims" if table == "claims" else "sections"):
        json.dumps(found, ensure_ascii=False, allow_nan=False).encode()  # no lone surrogates
    return {"study": study.name, f"{table}_module": path.name, **found}


def _claims_in(code: Snapshot) -> "list[Claim]":
    from gapsweep.analysis.claims import stated

    try:
        return stated(vars(load_module(code)))
    except ValueError as error:
        raise StudyError(f"{code.path}: {error}") from None


def _sections_in(code: Snapshot) -> "Callable[[Run], Any]":
    """The function ``sections`` of a user module."""
    found: Callable[[Run], Any] | None = getattr(load_module(code), "sections", None)
    if not callable(found):
        message = f"{code.path}: function sections(run) is missing; it returns parts of the report"
        raise StudyError(message)
    return found
