"""Sections of the report: the paper's bands of frequencies, its figures and its Table 2."""

from collections.abc import Iterator, Sequence
from contextlib import suppress
from itertools import chain

import numpy as np
import xarray as xr
from matplotlib.figure import Figure
from numpy.typing import NDArray

from gapsweep.analysis.claims import NotInRunError, Run
from gapsweep.model.labels import Representation
from gapsweep.report.drawing import caption_of_marks, labels_of
from gapsweep.report.parts import Figured, Part, Table
from gapsweep.report.scales import plain
from gapsweep.report.scenes import Scenes, swept
from gapsweep.report.tables import number, percent
from gapsweep.status import Status

from . import paper_figures as draw
from . import scenes
from .answer import answer
from .measures import AS_DRAWN, KINDS, late_periods, listed, named, ranges
from .scenes import (
    EXACT,
    HARD_ASYMMETRIC,
    NO_EVENTS,
    SOFT_SYMMETRIC,
    STRONG,
    SYMMETRIC,
    TABLE_2,
    TABLE_CASES,
    WEAK,
)
from .static_figures import CONSTRAINED, force_curves, static_convergence, unit_forces

LIMITS = (EXACT, NO_EVENTS, "tanh-1e6", "tanh-1e9")
PROTOCOLS = {"": "", "@paper": "; the paper's solver"}  # as labels end
FREE, RATIOS = ("poly-13", "poly-21"), ("ratpoly-3/5", "ratpoly-5/3", "ratpoly-5/5")
STATIC = {
    "2a": ((scenes.SOFT,), tuple(f"poly-{degree}" for degree in range(3, 22, 2))),
    "2b": ((scenes.SOFT,), (*FREE, *(law + CONSTRAINED for law in FREE))),
    "2c": ((scenes.HARD, scenes.VERY_SOFT), FREE),
    "3a": ((scenes.SOFT,), ("ratpoly-3/2", "ratpoly-5/3")),
    "3b": ((scenes.VERY_SOFT,), RATIOS),
    "3c": ((scenes.HARD,), RATIOS),
    "4": ((scenes.SOFT,), tuple(f"{family}-1e{n}" for n in (3, 4) for family in scenes.TANGENTS)),
}
SHOWN = {
    "6a": ((scenes.SOFT, scenes.LARGE), WEAK),
    "6a, smallest gap": ((scenes.SOFT, scenes.LARGE_ENDS[0]), WEAK),
    "6a, largest gap": ((scenes.SOFT, scenes.LARGE_ENDS[1]), WEAK),
    "6b": (SOFT_SYMMETRIC, WEAK),
    "6c": (scenes.SOFT_ASYMMETRIC, WEAK),
    "7": (scenes.SOFT_ASYMMETRIC, STRONG),
    "8a": ((scenes.VERY_SOFT, SYMMETRIC), WEAK),
    "8b": (SOFT_SYMMETRIC, WEAK),
    "8c": (scenes.HARD_SYMMETRIC, WEAK),
    "9": (scenes.HARD_SYMMETRIC, STRONG),
    "10": (HARD_ASYMMETRIC, LIMITS[1:]),
}
_PAPER = (
    "The paper: Insights on the continuous representations of piecewise-smooth nonlinear systems: "
    "limits of applicability and effectiveness. The table compares the frequencies that it states "
    "with those found here with the tight solver. A dash: none; +4: four narrower bands more."
)
_SCAN = (
    "Share of the frequencies from 12 to 30 Hz at which the exact law has period 3, inside and "
    "outside the band of Figs 6b and 8b, 17-21 Hz, over the initial condition (41 displacements, 5 "
    "velocities). Table 1 states rest, which leads to none. The other figures agree with +0.4 mm "
    "too: evidence, no proof."
)
_RATIONAL = (
    " 3/2 is the least-squares optimum and odd; the paper's 3/2 is not odd, and has a negative "
    "force in most of the gap."
)
_RUNGS = (
    "Error of the contact force over the degree or the convergence parameter: integrals over the "
    "range for smooth laws, means over points for fits; none below 1e-15. Dotted: the paper's "
    "bound for its weak grade."
)
_PEAKS = (
    "Peak displacement in the steady state over the forcing frequency, from fixed initial "
    "conditions. The exact law has its own panel, and larger dots behind each other law. Dashed: "
    "the upper wall."
)
_EXTREMA = (
    "Displacements at zero velocity in the steady state over the forcing frequency. Dashed: walls."
)
_SAME = "Red: peak or trough differ by more than 2 % of the gap; they are the same at"


def sections(run: Run) -> Iterator[Part]:
    """The answer, the paper's bands, its figures and its Table 2, as far as the run has them."""
    with suppress(NotInRunError):
        yield Part("answer", "Which law, where, at what cost", answer(run))
    rows, drawn = band_rows(run), figures(run)
    if first := next(drawn, None):
        tables = [Table("Frequencies in the paper and here", _BANDS_HEAD, rows)] if rows else []
        yield Part("paper", "The paper's figures", [_PAPER], tables, chain([first], drawn))
    if tables := costs(run):
        yield Part("table-2", "The paper's Table 2", [_TABLE_2_SAYS], tables)


def figures(run: Run) -> Iterator[Figured]:
    """The figures for which the run has the exact law and half of the paper's representations."""
    if "starts" in run.datasets:
        figure = draw.start_scan(run["starts"].load())
        yield _figured(figure, "of the initial conditions", *SOFT_SYMMETRIC, _SCAN)
    if "static" in run.datasets and SYMMETRIC in run["static"]["gap"].values:
        yield from _static_figures(run)
    found = Scenes(run["responses"])
    for name, (at, laws) in SHOWN.items():
        peaks = name[0] in "67"
        for protocol, solver in list(PROTOCOLS.items())[: 1 if peaks else None]:
            labels = [law + protocol for law in (EXACT, *laws)]
            scene = _scene(found, at, labels, of_any_start=peaks)
            if scene is None or (name == "10" and len(labels_of(scene)) < len(labels)):
                continue
            panels, words = _panels(name, scene), _PEAKS if peaks else _EXTREMA
            marks = {title: _apart(scene, *pair) for title, pair in panels.items() if name == "10"}
            n_columns = 3 if peaks else len(_starts(scene))
            figure = draw.diagram(scene, panels, n_columns, peaks=peaks, ticks=marks)
            same = (f"{percent(1.0 - hits.mean())} ({title})" for title, hits in marks.items())
            words += f" {_SAME} {', '.join(same)}." * bool(marks)
            n = np.count_nonzero(scene["status"] != Status.NOT_REQUESTED)
            counts = ", ".join(filter(None, (f"{n} points", draw.without_response(scene))))
            words += f"{caption_of_marks(figure)} {counts}."
            words += "" if solver or name not in ("6a", "6b", "8c") else _compared(name, scene)
            yield _figured(figure, f"{name}{', their solver' * bool(solver)}", *at, words, solver)
    if "histories" in run.datasets:
        yield from _histories(run["histories"])


def _figured(
    figure: Figure, name: str, K_c: float | Sequence[float], gap: str, words: str, more: str = ""
) -> Figured:
    """A figure whose caption states its case, and everything that is seen in it."""
    stiffness = " and ".join(plain(one) for one in np.atleast_1d(K_c).tolist())
    words = f"Figure {name}. K_c = {stiffness} N/m, gap {gap} mm{more}. {words}"
    return Figured(figure, words, words, f"Fig. {name}")


def _static_figures(run: Run) -> Iterator[Figured]:
    static = run.select("static", gap=SYMMETRIC)
    within = ((static["x"] >= -static["j_1"]) & (static["x"] <= static["j_2"])).values
    for name, (stiffnesses, laws) in STATIC.items():
        forces = unit_forces(static, laws)
        largest = {law: abs(forces[law][within]).max() for law in laws}
        leaks = (
            ", ".join(f"{law} {number(K_c * most)}" for law, most in largest.items())
            for K_c in stiffnesses
        )
        words = (
            f"Contact force near the gap (shaded), and its error over the fit range. Largest force "
            f"in the gap [N], by row: {'; '.join(leaks)}; the forcing is "
            f"{abs(static['forcing'].item()):g} N. Every force is proportional to K_c: relative "
            f"errors are the same at every stiffness.{_RATIONAL * (name == '3a')}"
        )
        figure = force_curves(static, forces, stiffnesses)
        yield _figured(figure, name, stiffnesses, SYMMETRIC, words)
    if "ladders" in run.datasets:
        figure = static_convergence(run.select("ladders", gap=SYMMETRIC))
        yield _figured(figure, "5", *SOFT_SYMMETRIC, _RUNGS)


def _scene(
    found: Scenes, at: scenes.Case, labels: list[str], *, of_any_start: bool = False
) -> xr.Dataset | None:
    """Responses that a figure shows, of fixed initial conditions; None if too few were swept."""
    scene = found.labelled(*at)
    if scene is None or labels[0] not in labels_of(scene):
        return None
    here = [label for label in labels if label in labels_of(scene)]
    starts = scene["start"].values == "fixed" if of_any_start else sorted(_starts(scene).values())
    scene = swept(scene.sel(representation=here).isel(initial_condition=starts))
    left = labels_of(scene)
    enough = 2 * len(left) >= len(labels) and labels[0] in left and scene.sizes["omega"] > 1
    return scene if enough else None


def _panels(name: str, scene: xr.Dataset) -> dict[str, list[draw.Layer]]:
    """Titles of the panels of a figure, and the dots of each: laws and initial conditions."""
    exact, *laws = labels = labels_of(scene)
    if name[0] in "67":
        every = range(scene.sizes["initial_condition"])
        return {law: [(one, every) for one in dict.fromkeys((exact, law))] for law in labels}
    pairs = [[law] for law in labels]
    if name == "10":
        pairs = [*([laws[0], law] for law in laws[1:]), [exact, laws[0]]]
    return {
        f"{' on '.join(Representation(law).law for law in reversed(pair))}, from {start}": [
            (law, [at]) for law in pair
        ]
        for pair in pairs
        for start, at in _starts(scene).items()
    }


def _apart(scene: xr.Dataset, *layers: draw.Layer) -> NDArray[np.bool_]:
    """Frequencies at which two laws differ as a plot shows, in the peak or the trough."""
    ends = [
        scene[["x_max", "x_min"]].sel(representation=law).isel(initial_condition=starts[0])
        for law, starts in layers
    ]
    near = AS_DRAWN * (scene["j_1"] + scene["j_2"])
    same = abs(ends[0] - ends[1]).to_dataarray().max("variable", skipna=False) <= near
    return np.asarray(~same)


def _starts(scene: xr.Dataset) -> dict[str, int]:
    """Positions of the paper's initial conditions, the one that its figures agree with first."""
    return {
        name: int(at[0])
        for name, (x, v) in reversed(scenes.STARTS.items())
        if (at := np.flatnonzero((abs(scene["x_0"] - x) < 1e-12) & (scene["v_0"] == v))).size
    }


def _compared(name: str, scene: xr.Dataset) -> str:
    """Frequencies that the paper states, and range and number of those of each law here."""
    starts = {f" from {start}": [at] for start, at in _starts(scene).items()}
    if name[0] in "67":
        starts = {"": list(range(scene.sizes["initial_condition"]))}
    words = ""
    for _, paper, kind, band in (one for one in BANDS if one[0] == name and one[2] in DIFFERENT):
        words += f" Paper: {paper} Hz."
        for start, at in starts.items():
            some = scene.sel(omega=slice(*band)).isel(initial_condition=at)
            hits, found = KINDS[kind][1](some).any("initial_condition"), []
            for law in labels_of(some):
                w = some["omega"].values[hits.sel(representation=law).values]
                found += [f"{named(law)} {w[0]:g}-{w[-1]:g} Hz ({w.size})"] if w.size else []
            words += f" Here {kind}{start} (number of frequencies): {listed(found)}."
    return words


def _histories(histories: xr.Dataset) -> Iterator[Figured]:
    """Figure 11."""
    K_c, gap = HARD_ASYMMETRIC
    here = (histories["K_c"] == K_c) & (histories["gap"] == gap)
    laws = [*(law + "@paper" for law in LIMITS), EXACT + "@paper-mode"]
    laws = [law for law in laws if law in labels_of(histories)]
    scene = swept(histories.isel(history=here.values).sel(representation=laws).load())
    if EXACT + "@paper" not in labels_of(scene):
        return
    periods = (
        f"{label} {', '.join(f'P{n}' if n else 'none' for n in found)}"
        for label, found in zip(labels_of(scene), late_periods(scene).T.tolist(), strict=True)
    )
    words = (
        f"Displacement in the last {draw.SHOWN_PERIODS} forcing periods, and its spectrum (Hann "
        f"window). {_FIG_11} Here, to 2 % of the gap (root mean square), by row: "
        f"{'; '.join(periods)}."
    )
    figure = draw.histories_and_spectra(scene)
    yield _figured(figure, "11, their solver", *HARD_ASYMMETRIC, words, PROTOCOLS["@paper"])


_FIG_11 = (
    "The paper has period 1 with events and period 3 without them and with tanh at 11 Hz, and "
    "period 2 at 21.75 Hz."
)
# Figure, the paper's words, the kind of response that is looked for, within which frequencies [Hz].
BANDS = (
    ("6a", "superharmonic near 2", "largest amplitude", (1.2, 3.0)),
    ("6a", "RatPoly: subharmonic 11-12", "period above 1", (4.0, 30.0)),
    ("6a", "RatPoly: peak below 0 from 22", "peak below 0", (15.0, 30.0)),
    ("6b", "subharmonic (log-arctan: none) 17-21", "period 3", (12.0, 30.0)),
    ("6c", "jump near 12", "largest amplitude", (0.0, 30.0)),
    ("6c", "chaos 13-15", "chaos", (10.0, 30.0)),
    ("6c", "RatPoly: 15-18, subharmonic 21-22", "period above 1", (13.0, 30.0)),
    ("8b", "chaos 4-5", "chaos", (3.0, 6.0)),
    ("8b", "transitions near 6 and 7", "period above 1", (5.2, 8.5)),
    ("8b", "RatPoly, arctan: after the jump", "period not 1", (10.0, 17.0)),
    ("8b", "subharmonic 17-21", "period 3", (12.0, 30.0)),
    ("8c", "RatPoly: negative mean to 20", "negative mean", (0.0, 20.0)),
    ("8c", "RatPoly: larger above 20; tanh: never", "crosses 0", (0.0, 30.0)),
    ("9", "more behaviour 10-12", "period not 1", (9.0, 13.0)),
    ("9", "higher periods 12-20", "period above 1", (12.0, 20.0)),
    ("9", "log-arctan: beyond 20", "period not 1", (20.0, 30.0)),
)
DIFFERENT = ("period above 1", "period 3", "peak below 0", "negative mean")  # in Figs 6a, 6b, 8c
_LAWS = ("exact", "Poly", "RatPoly", "tanh", "arctan", "log-arctan")
_HYPHEN = "\u2011"  # at which no line is broken
_BANDS_HEAD = ["Fig.", "Paper [Hz]", "Here [Hz]", "From", *_LAWS]


def band_rows(run: Run) -> list[list[str]]:
    """The paper's and our frequencies of every band that the paper names."""
    found, rows = Scenes(run["responses"]), []
    for place, paper, kind, (low, high) in BANDS:
        at, laws = SHOWN[place]
        scene = _scene(found, at, [EXACT, *laws])
        if scene is None:
            continue
        for start, n in _starts(scene).items():
            some = scene.sel(omega=slice(low, high)).isel(initial_condition=n)
            here = [law if law in labels_of(some) else "" for law in (EXACT, *laws)]
            cells = (law and _ranges(some.sel(representation=law), kind) for law in here)
            rows.append([place, paper, kind, start, *cells])
    for start in scenes.STARTS if "bands" in run.datasets else ():
        one = run["bands"].sel(start=start, representation=[EXACT, *WEAK])
        jumps = [f"{omega:.2f}" for omega in one["peak"].values]
        pairs = zip(one["low"].values, one["high"].values, strict=True)
        three = [f"{low:.2f}{_HYPHEN}{high:.2f}" if low < high else "–" for low, high in pairs]
        rows.append(["8b", "primary peak", "jump, bisected", start, *jumps])
        rows.append(["8b", "subharmonic 17-21", "period 3, widest, bisected", start, *three])
    return sorted(rows, key=lambda row: row[0])


def _ranges(one: xr.Dataset, kind: str) -> str:
    """Frequencies at which the response is of a kind, as ``17, 17.4-20.6, +2``."""
    one = one.isel(omega=one["status"].values != Status.NOT_REQUESTED)
    words = ranges(one["omega"].values, KINDS[kind][1](one).values)
    short = {" Hz": "", "no frequency": "–", "-": _HYPHEN, " and ": ", +", " narrower": ""}
    for long, written in short.items():
        words = words.replace(long, written)
    return words


_TABLE_2_SAYS = (
    "Right-hand sides and processor time (this machine's) per forcing period, the means over "
    "frequencies and initial conditions, with the paper's tolerances, step control and restarts, "
    "and the paper's seconds for a whole diagram. A factor in seconds but not in right-hand "
    "sides is overhead."
)
_COSTS = ("Right-hand sides", "Time [µs]", "Paper [s]")
_TABLE_2_HEAD = ["Law", *(word for cost in _COSTS for word in (cost, "over exact"))]


def costs(run: Run) -> list[Table]:
    """Table 2 and the costs of a forcing period here, as far as the run has them."""
    tables = []
    for (grade, paper), figure in zip(TABLE_2.items(), ("Fig. 8b", "Fig. 9"), strict=True):
        found: dict[str, list[float]] = {}
        for law, seconds in paper.items():
            with suppress(NotInRunError):
                names = ("nfev", "cpu_time", "t_simulated")
                one = run.points(f"{law}@paper", *TABLE_CASES[grade], *names, start="any")
                n_periods = one["t_simulated"] * one["omega"]
                means = (float((one[name] / n_periods).mean()) for name in names[:2])
                found[law] = [next(means), 1e6 * next(means), seconds]
        if len(found) > 1 and (exact := found.get(EXACT)):
            ratios = {law: np.divide(cost, exact) for law, cost in found.items()}
            rows = [
                [law, *map(number, np.column_stack([found[law], ratios[law]]).ravel())]
                for law in found
            ]
            tables.append(Table(figure, _TABLE_2_HEAD, rows))
    return tables
