"""`gapsweep.explore`, and the page of the command ``gapsweep explore``."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from gapsweep.errors import ModelError
from gapsweep.explorer.first_question import (
    DEFAULT_APPROXIMATIONS,
    not_computed,
    of_model,
    of_study,
)
from gapsweep.explorer.question import Question
from gapsweep.explorer.server import Explorer
from gapsweep.explorer.stored import StoredRun
from gapsweep.integrate.problem import Model
from gapsweep.integrate.simulate import AnyLaw
from gapsweep.model.doubts import doubts
from gapsweep.model.labels import EXACT
from gapsweep.store.artefact import reading
from gapsweep.study.study import Study


def explore(
    oscillator: Model | Callable[..., Model] | None = None,
    law: AnyLaw | None = None,
    *,
    approximations: Sequence[str] = DEFAULT_APPROXIMATIONS,
    port: int = 0,
) -> Explorer:
    """Open a page whose figures follow its sliders.

    In a notebook the result shows the page; elsewhere open its ``url`` in a browser. Needs Bokeh:
    ``pip install 'gapsweep[explore]'``.

    Parameters
    ----------
    oscillator : Oscillator, System, or callable, optional
        Initial values of the sliders; the defaults if None. A function that returns a forced System
        has a slider for each of its keywords, whose defaults are the initial values.
    law : ContactLaw or mapping of str to ContactLaw, optional
        Contact law with the initial stiffness and gap of the sliders, for each contact if there are
        several; None: 14000 N/m, and 0.4 mm on both sides.
    approximations : sequence of str
        Labels of up to three laws in addition to the exact one.
    port : int
        Port of this machine, 0: any that is free.

    Returns
    -------
    Explorer
        The page, with its `url`; `stop` or the end of the process closes it.

    Raises
    ------
    ModelError
        If an argument has another type or is out of range, or Bokeh is missing.

    Examples
    --------
    >>> import gapsweep as gs
    >>> page = gs.explore(approximations=["tanh-1e4", "poly-13"])
    >>> page.url.startswith("http://")
    True
    >>> page.stop()
    """
    return opened(of_model(oscillator, law, approximations=approximations), port=port)


def explore_path(path: Path | None, port: int) -> Explorer:
    """The page of a study file, of the folder of a run, or of the defaults."""
    if path is None:
        return opened(of_model(), port=port)
    if path.is_dir():
        with reading(path):
            stored = StoredRun(path)
        return opened(stored.question, stored.ranges, stored, stored.note, port=port)
    study = Study.load(path)
    return opened(*of_study(study), note=not_computed(study), port=port)


def opened(
    question: Question,
    ranges: dict[str, tuple[float, float]] | None = None,
    stored: StoredRun | None = None,
    note: str = "",
    *,
    port: int,
) -> Explorer:
    """Start a page; every visitor has separate sliders."""
    try:
        # Bokeh is an optional dependency, and takes a second to import.
        from gapsweep.explorer.page import Page
    except ModuleNotFoundError as error:
        if (error.name or "").partition(".")[0] != "bokeh":
            raise
        raise ModelError(
            "explore: needs Bokeh, which is not installed: pip install 'gapsweep[explore]'"
        ) from None

    starts = np.array([question.start])
    found = doubts([question.model], [question.laws(EXACT)], question.band, starts)
    text = ". ".join([note] * bool(note) + [*found])

    def fill(document: Any) -> Callable[[], None]:
        return Page(document, question, ranges or {}, stored, text).stop

    return Explorer(fill, port)
