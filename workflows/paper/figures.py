"""Sections of the report: those of the paper's figures that a run has the points for, and Table 2.

`PAPER` says what each of figures 6 to 10 shows: its scene, its representations and its function.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
import xarray as xr
from matplotlib.figure import Figure

from gapsweep.analysis.verdicts import Run
from gapsweep.report.drawing import labels_of
from gapsweep.report.parts import Figured, Part, Table
from gapsweep.report.scenes import Scenes, swept
from gapsweep.report.tables import number
from gapsweep.response.result import ResponseClass
from gapsweep.status import Status

from . import scenes
from .paper_figures import (
    SHOWN_PERIODS,
    histories_and_spectra,
    kind,
    peak_curves,
    stacked_bifurcations,
)
from .scenes import ASYMMETRIC, EXACT, HARD, LARGE, NO_EVENTS, SOFT, SYMMETRIC, VERY_SOFT
from .static_figures import (
    polynomial_forces,
    rational_forces,
    smooth_forces,
    static_convergence,
)

_MM = 1e3
WEAK, STRONG = (EXACT, *scenes.WEAK), (EXACT, *scenes.STRONG)
LIMITS = (EXACT, NO_EVENTS, "tanh-1e6", "tanh-1e9")
HISTORIES_AT = (11.0, 21.75)


@dataclass(frozen=True, slots=True)
class PaperFigure:
    """What a figure of the paper shows.

    Attributes
    ----------
    K_c : float
        Contact stiffness [N/m].
    gap : str
        As in datasets.
    draw : callable
        From the responses of the scene and labels to the figure.
    from_rest : bool
        Whether only the start at rest is shown.
    """

    number: str
    title: str
    labels: tuple[str, ...]
    K_c: float
    gap: str
    draw: Callable[[xr.Dataset], Figure]
    caption: str
    from_rest: bool = False


def sections(run: Run) -> Iterator[Part]:
    """The paper's figures and its Table 2, as far as the run has what they show."""
    yield Part("paper", "The paper's figures", [], figures=figures(run))
    tables = list(cost_tables(run["timing"]))
    if tables:
        yield Part("table-2", "The paper's Table 2", [_TABLE_2_WORDS], tables)


def figures(run: Run) -> Iterator[Figured]:
    """Those of the paper's figures that the run has enough for, in the paper's order.

    Figures 6 to 10 are drawn once for every protocol (``@NAME``) that the labels have. They
    need the exact law and at least half of the paper's representations.
    """
    responses, stored = run["responses"], run.datasets
    swept_scenes = Scenes(responses)
    if "static" in stored:
        yield from _static_figures(stored["static"], stored.get("ladders"))
    for wanted in PAPER:
        for protocol in _protocols(responses):
            scene = _scene(swept_scenes, wanted, protocol)
            if scene is not None:
                yield _drawn(wanted, scene)
    if "histories" in stored:
        yield from _history_figures(stored["histories"])


_PEAKS_CAPTION = (
    "Peak displacement of the steady response from all starts. Black: the exact law, alone and "
    "behind the others. Black that shows is missed, colour without black is invented; pale "
    "points are not periodic; triangles lie above the frame; dashed: walls. The axis is "
    "logarithmic where peaks reach far beyond the walls."
)
_EXTREMA_CAPTION = (
    "All steady zero-velocity displacements from rest. Shades: frequencies at which the response "
    "is chaotic, unresolved or failed; dashed: walls; triangles: outside the frame."
)
PAPER = (
    PaperFigure(
        "6a", "Peak displacement, large gap", WEAK, SOFT, LARGE, peak_curves, _PEAKS_CAPTION
    ),
    PaperFigure(
        "6b", "Peak displacement, soft", WEAK, SOFT, SYMMETRIC, peak_curves, _PEAKS_CAPTION
    ),
    PaperFigure(
        "6c",
        "Peak displacement, soft, asymmetric",
        WEAK,
        SOFT,
        ASYMMETRIC,
        peak_curves,
        _PEAKS_CAPTION,
    ),
    # The paper does not state the scene of Fig. 7: study.toml says why this one.
    PaperFigure(
        "7",
        "Peak displacement, soft, asymmetric, strong grade",
        STRONG,
        SOFT,
        ASYMMETRIC,
        peak_curves,
        _PEAKS_CAPTION,
    ),
    *(
        PaperFigure(
            number, title, labels, K_c, gap, stacked_bifurcations, _EXTREMA_CAPTION, from_rest=True
        )
        for number, title, labels, K_c, gap in (
            ("8a", "Bifurcation diagrams, very soft", WEAK, VERY_SOFT, SYMMETRIC),
            ("8b", "Bifurcation diagrams, soft", WEAK, SOFT, SYMMETRIC),
            ("8c", "Bifurcation diagrams, hard", WEAK, HARD, SYMMETRIC),
            ("9", "Bifurcation diagrams, hard", STRONG, HARD, SYMMETRIC),
            ("10", "Bifurcation diagrams, limit of tanh", LIMITS, HARD, ASYMMETRIC),
        )
    ),
)


# Table 2: total seconds of the diagrams of Figs 8b and 9, in the order of WEAK and STRONG.
TABLE_2 = (
    ("Fig. 8b", WEAK, SOFT, SYMMETRIC, (48.69, 18.57, 26.49, 7.66, 7.41, 7.29)),
    ("Fig. 9", STRONG, HARD, SYMMETRIC, (117.7, 65.69, 132.9, 18.57, 18.08, 18.49)),
)


_TABLE_2_WORDS = (
    "Processor time of a whole diagram from rest with the paper's solver settings (its tolerances, "
    "step control and restarts), beside the paper's seconds. Only ratios to the exact law compare: "
    "machines, engines and run lengths differ. Fewer frequencies than the paper's make shorter "
    "times, not other ratios."
)
_TABLE_2_HEAD = ["Representation", "Ours [s]", "Ratio to exact", "Paper [s]", "Paper's ratio"]


def cost_tables(timing: xr.Dataset) -> Iterator[Table]:
    """Table 2 of the paper beside our own times, where the study has its protocol ``@paper``.

    Parameters
    ----------
    timing : Dataset
        As stored in ``timing.nc``.
    """
    stored = labels_of(timing)
    exact = f"{EXACT}@paper"
    for place, labels, K_c, gap, seconds in TABLE_2:
        if K_c not in timing["K_c"].values or gap not in timing["gap"].values:
            continue
        scene = timing[["cpu_time_mean", "n_points"]].sel(K_c=K_c, gap=gap).load()
        total = scene["cpu_time_mean"] * scene["n_points"]
        theirs = {f"{label}@paper": t for label, t in zip(labels, seconds, strict=True)}
        others = [label for label in stored if label.startswith(f"{EXACT}") and "@" in label]
        shown = [r for r in dict.fromkeys([*theirs, *others]) if r in stored]
        n_points = {r: int(scene["n_points"].sel(representation=r)) for r in shown}
        shown = [r for r in shown if n_points[r] == n_points.get(exact, 0) > 0]
        if exact not in shown or len(shown) < 2:
            continue
        ours = {r: float(total.sel(representation=r)) for r in shown}
        yield Table(
            f"{place}, {n_points[exact]} frequencies",
            _TABLE_2_HEAD,
            [
                [
                    label,
                    *_with_ratio(ours[label], ours[exact]),
                    *_with_ratio(theirs.get(label, np.nan), seconds[0]),
                ]
                for label in shown
            ],
        )


def _with_ratio(seconds: float, exact: float) -> tuple[str, str]:
    return number(seconds), number(seconds / exact)


def _scene(swept_scenes: Scenes, wanted: PaperFigure, protocol: str) -> xr.Dataset | None:
    """What a figure shows; None if too little of it was swept."""
    scene = swept_scenes.labelled(wanted.K_c, wanted.gap)
    if scene is None:
        return None
    stored = set(labels_of(scene))
    labels = [label + protocol for label in wanted.labels if label + protocol in stored]
    if wanted.from_rest:
        at_rest = (scene["start"] == "fixed") & (scene["x_0"] == 0.0) & (scene["v_0"] == 0.0)
        if not at_rest.any():
            return None
        scene = scene.isel(initial_condition=int(np.argmax(at_rest.values)))
    scene = swept(scene.sel(representation=labels))
    here = labels_of(scene)
    enough = 2 * len(here) >= len(wanted.labels) and EXACT + protocol in here
    return scene if enough and scene.sizes["omega"] > 1 else None


def _drawn(wanted: PaperFigure, scene: xr.Dataset) -> Figured:
    labels = labels_of(scene)
    _, at, protocol = labels[0].partition("@")
    where = (
        f"K_c = {_plain(wanted.K_c)} N/m, gap {scene['gap'].item()} mm{at and f', {at}{protocol}'}"
    )
    status = scene["status"].values
    counts = (
        f"{status.size} sweep points from {_starts(scene)}: "
        f"{int((status == Status.UNRESOLVED).sum())} unresolved, "
        f"{int((status > Status.OUT_OF_FIT_RANGE).sum())} failed."
    )
    return Figured(
        wanted.draw(scene),
        f"Figure {wanted.number}. {wanted.title} ({where}). {wanted.caption} {counts}",
        f"{wanted.title}, {where}. {_in_words(scene)}",
    )


def _starts(scene: xr.Dataset) -> str:
    kinds = np.atleast_1d(scene["start"].values).astype(str).tolist()
    if "initial_condition" not in scene.dims:
        return "rest"
    n_fixed = kinds.count("fixed")
    sweeps = [kind.replace("_", " ") for kind in kinds if kind != "fixed"]
    fixed = [f"{n_fixed} fixed start{'s' if n_fixed > 1 else ''}"] if n_fixed else []
    return ", ".join(fixed + sweeps)


def _in_words(scene: xr.Dataset) -> str:
    """Per representation, the largest peak, where it is, and how much is periodic."""
    sentences = []
    for label in labels_of(scene):
        one = scene.sel(representation=label)
        peaks = one["x_max"].max([d for d in one["x_max"].dims if d != "omega"])
        if not np.isfinite(peaks).any():
            sentences.append(f"{label}: no result.")
            continue
        at = int(np.nanargmax(peaks.values))
        share = float((one["response_class"] == ResponseClass.PERIODIC).mean())
        sentences.append(
            f"{label}: largest peak {float(peaks[at]) * _MM:.3g} mm at "
            f"{float(peaks['omega'][at]):g} Hz, {100 * share:.0f} % of the responses periodic."
        )
    return " ".join(sentences)


def _static_figures(static: xr.Dataset, ladders: xr.Dataset | None) -> Iterator[Figured]:
    if SYMMETRIC not in static["gap"].values:
        return
    scene = static.sel(gap=SYMMETRIC).load()
    curves = (
        "Contact force near the gap, its error there, and its error in the fit range; one column "
        "per stiffness. Shade: the gap; dotted: the forcing p."
    )
    for which, name, draw in (
        ("2", "Polynomials", polynomial_forces),
        ("3", "Rational polynomials", rational_forces),
        ("4", "Smooth laws", smooth_forces),
    ):
        title = f"{name}, gap {SYMMETRIC} mm."
        yield Figured(draw(scene), f"Figure {which}. {title} {curves}", f"{title} {curves}")
    if ladders is not None:
        title = f"Static convergence, gap {SYMMETRIC} mm."
        words = (
            "Errors per unit stiffness against degree and convergence parameter; dotted: in-gap "
            "force of a tenth of the forcing."
        )
        figure = static_convergence(ladders.sel(gap=SYMMETRIC).load(), float(scene["forcing"]))
        yield Figured(figure, f"Figure 5. {title} {words}", f"{title} {words}")


def _history_figures(histories: xr.Dataset) -> Iterator[Figured]:
    """Figure 11, once for every protocol."""
    chosen = [
        h
        for h in range(histories.sizes["history"])
        if float(histories["omega"][h]) in HISTORIES_AT
        and float(histories["K_c"][h]) == HARD
        and histories["gap"].values[h] == ASYMMETRIC
    ]
    stored = labels_of(histories)
    for protocol in _protocols(histories):
        labels = [label + protocol for label in LIMITS if label + protocol in stored]
        scene = histories.isel(history=chosen).sel(representation=labels)
        scene = swept(scene.load())
        if 2 * scene.sizes["representation"] < len(LIMITS) or not scene.sizes["history"]:
            continue
        frequencies = " and ".join(f"{omega:g} Hz" for omega in scene["omega"].values)
        title = f"Time histories and spectra at {frequencies} (K_c = {_plain(HARD)} N/m, "
        title += f"gap {ASYMMETRIC} mm{protocol and f', {protocol}'})"
        caption = (
            f"Last {SHOWN_PERIODS} forcing periods of the motion from the start, and amplitude "
            f"spectrum of its last {int(scene['n_periods'].max())} (Hann window). "
            "P3: repeats after three periods."
        )
        words = (
            f"{label} at {float(one['omega']):g} Hz: {kind(one.sel(representation=label))}"
            for one in (scene.isel(history=h) for h in range(scene.sizes["history"]))
            for label in labels_of(scene)
        )
        description = f"{title}. {'; '.join(words)}."
        yield Figured(histories_and_spectra(scene), f"Figure 11. {title}. {caption}", description)


def _protocols(dataset: xr.Dataset) -> list[str]:
    """Suffixes of the labels; the empty one, where there is no protocol, first."""
    return sorted({label.removeprefix(label.partition("@")[0]) for label in labels_of(dataset)})


def _plain(K_c: float) -> str:
    return f"{K_c:g}".replace("e+0", "e")
