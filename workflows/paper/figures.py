"""Sections of the report: the paper's figures that a run has the points for, its bands, Table 2."""

from collections.abc import Iterator
from contextlib import suppress
from itertools import chain

import numpy as np
import xarray as xr
from matplotlib.figure import Figure

from gapsweep.analysis.verdicts import NotInRunError, Run
from gapsweep.report.drawing import labels_of, said_of_marks
from gapsweep.report.parts import Figured, Part, Table
from gapsweep.report.scales import plain
from gapsweep.report.scenes import Scenes, said_of_starts, swept
from gapsweep.report.tables import number, percent
from gapsweep.response.result import ResponseClass
from gapsweep.status import Status

from . import paper_figures as draw
from . import scenes
from .claims import TABLE_2, TABLE_SCENES
from .measures import (
    Band,
    Scene,
    frequencies,
    late_periods,
    listed,
    moved_on,
    per_period,
    ranges,
    same_picture,
)
from .scenes import EXACT, HARD_ASYMMETRIC, NO_EVENTS, SOFT_SYMMETRIC, STRONG, SYMMETRIC, WEAK
from .static_figures import constrained_forces, force_curves, forces_of, static_convergence

LIMITS = (EXACT, NO_EVENTS, "tanh-1e6", "tanh-1e9")
TIGHT, PAPER = "", "@paper"  # protocols, as labels end
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
}
_PAPER = (
    "The paper: Insights on the continuous representations of piecewise-smooth nonlinear systems: "
    "limits of applicability and effectiveness."
)
_PEAKS_SAY = (
    "The exact law stands alone, and behind the others: what shows of it is "
    "missed, colour without it invented. Dashed: the upper wall."
)
_OTHER_STIFFNESSES = {
    name: f": Fig. {name[0]}c, at other stiffnesses, shows the same curves" for name in ("2a", "3a")
}
_EXTREMA_SAY = "All steady zero-velocity displacements from rest; dashed: walls."


def sections(run: Run) -> Iterator[Part]:
    """The paper's figures, its bands of frequencies and its Table 2, as far as the run has them."""
    drawn = figures(run)
    if first := next(drawn, None):
        yield Part("paper", "The paper's figures", [_PAPER], figures=chain([first], drawn))
    if rows := band_rows(run):
        yield Part("bands", "The paper's bands", [_BANDS_SAY], [Table("", _BANDS_HEAD, rows)])
    sentences, tables = costs(run)
    if tables:
        yield Part("table-2", "The paper's Table 2", [_TABLE_2_SAYS, *sentences], tables)


def figures(run: Run) -> Iterator[Figured]:
    """The figures that the run has enough for, in the paper's order.

    Figures 6 to 10 need the exact law and half of the paper's representations; those from rest
    are drawn for the tight solver and for the paper's.
    """
    if "static" in run.datasets and SYMMETRIC in run["static"]["gap"].values:
        yield from _static_figures(run)
    found = Scenes(run["responses"])
    for name, (at, laws) in SHOWN.items():
        if name[0] in "67":
            if (scene := _scene(found, at, laws)) is not None:
                figure = draw.peak_curves(scene)
                peaks = f"Peaks{said_of_starts(scene) or ' from 1 start'}. {_PEAKS_SAY}"
                words = (f"{peaks}{said_of_marks(figure)}", _counts(scene))
                yield _figured(figure, name, at, TIGHT, *words)
            continue
        for protocol in (TIGHT, PAPER):
            if (scene := _scene(found, at, laws, protocol)) is not None:
                figure = draw.stacked_bifurcations(scene)
                words = (f"{_EXTREMA_SAY}{said_of_marks(figure)}", _counts(scene))
                yield _figured(figure, name, at, protocol, *words)
    for protocol in (TIGHT, PAPER):
        scene = _scene(found, HARD_ASYMMETRIC, LIMITS[1:], protocol)
        if scene is not None and scene.sizes["representation"] == len(LIMITS):
            yield _overlay(run, scene, protocol)
    if "histories" in run.datasets:
        yield from _histories(run)


def _figured(figure: Figure, name: str, at: Scene, protocol: str, *sentences: str) -> Figured:
    """A figure whose caption says its scene, and everything that is seen in it."""
    solver = f"the paper's solver ({protocol})" if protocol == PAPER else ""
    where = ", ".join(filter(None, (f"K_c = {plain(at[0])} N/m", f"gap {at[1]} mm", solver)))
    place = f"{name}{', their solver' * (protocol == PAPER)}"
    words = f"Figure {place}. {where}. {' '.join(sentences)}"
    return Figured(figure, words, words, f"Fig. {place}")


def _static_figures(run: Run) -> Iterator[Figured]:
    static = run.select("static", gap=SYMMETRIC)
    within = ((static["x"] >= -static["j_1"]) & (static["x"] <= static["j_2"])).values
    free = forces_of(static, ("poly-13", "poly-21"))
    smooth = [f"{family}-1e{n}" for n in (3, 4) for family in scenes.TANGENTS]
    for name, forces in {
        "2a": forces_of(static, ("poly-3", "poly-7")) | free,
        "2b": free | constrained_forces(static, free),
        "3a": forces_of(static, ("ratpoly-3/2", "ratpoly-5/3")),
        "3b": forces_of(static, ("ratpoly-3/5", "ratpoly-5/3", "ratpoly-5/5")),
        "4": forces_of(static, smooth),
    }.items():
        leaks = listed(f"{law} {np.max(np.abs(f[within])):.2g}" for law, f in forces.items())
        fits = "Fits are least-squares optima. " * any("poly" in law for law in forces)
        fits += "Constrained ones have no constant and linear terms. " * (name == "2b")
        words = (
            f"Shade: the gap. {fits}Largest force in the gap [N]: {leaks}; the forcing is "
            f"{abs(static['forcing'].item()):g} N. Forces are proportional to K_c"
            f"{_OTHER_STIFFNESSES.get(name, '')}."
        )
        yield _figured(force_curves(static, forces), name, SOFT_SYMMETRIC, TIGHT, words)
    if "ladders" in run.datasets:
        figure = static_convergence(run.select("ladders", gap=SYMMETRIC))
        words = (
            "Errors of the smooth laws are integrals over the range, those of fits means over "
            "their points; none is shown below 1e-15, where all is rounding. Dotted: the paper's "
            "bound for its weak grade."
        )
        yield _figured(figure, "5", SOFT_SYMMETRIC, TIGHT, words)


def _scene(
    found: Scenes, at: Scene, laws: tuple[str, ...], protocol: str | None = None
) -> xr.Dataset | None:
    """What a figure shows, with a protocol from rest only; None if too little was swept."""
    scene = found.labelled(*at)
    if scene is None:
        return None
    wanted = [law + (protocol or TIGHT) for law in (EXACT, *laws)]
    scene = scene.sel(representation=[label for label in wanted if label in labels_of(scene)])
    if protocol is not None:
        rest = (scene["start"] == "fixed") & (scene["x_0"] == 0.0) & (scene["v_0"] == 0.0)
        if not rest.any():
            return None
        scene = scene.isel(initial_condition=int(np.argmax(rest.values)))
    scene = swept(scene)
    here = labels_of(scene)
    enough = 2 * len(here) >= len(wanted) and wanted[0] in here
    return scene if enough and scene.sizes["omega"] > 1 else None


def _counts(scene: xr.Dataset) -> str:
    """How many points there are, and how high each law peaks."""
    status, height = scene["status"].values, scene["x_max"]
    beyond, is_steady = status == Status.OUT_OF_FIT_RANGE, np.isfinite(height.values)
    highest = 1e3 * height.max([dim for dim in height.dims if dim != "representation"]).values
    peaks = (f"{label} {number(x)}" for label, x in zip(labels_of(scene), highest, strict=True))
    return (
        f"{np.sum(status != Status.NOT_REQUESTED)} points, "
        f"{np.sum(status == Status.UNRESOLVED)} unresolved, "
        f"{np.sum(status > Status.OUT_OF_FIT_RANGE)} failed, "
        f"{np.sum(beyond & is_steady)} beyond the range of their fit, "
        f"{np.sum(beyond & ~is_steady)} that left it without a steady response. "
        f"Largest peaks [mm]: {listed(peaks)}."
    )


def _overlay(run: Run, scene: xr.Dataset, protocol: str) -> Figured:
    """Figure 10 for one protocol."""
    overlays, same = [], []
    for front, rear in (*((law, NO_EVENTS) for law in LIMITS[2:]), (NO_EVENTS, EXACT)):
        hits = same_picture(run, front + protocol, rear + protocol, HARD_ASYMMETRIC)
        omega = run.points(front + protocol, *HARD_ASYMMETRIC, "x_max")["omega"].values
        overlays.append((front + protocol, rear + protocol, omega[hits.each == 0.0]))
        same.append(f"{percent(hits.value)} ({front} on {rear})")
    seen = [
        f"{_EXTREMA_SAY} Larger: the law behind. Red: peak or trough differ by more than 2 % of "
        f"the gap; they are the same at {listed(same)} of the frequencies."
    ]
    with suppress(NotInRunError):  # the tight solver may not have been asked
        seen += list(_not_periodic(run, protocol))
    figure = draw.overlaid_bifurcations(scene, overlays)
    return _figured(figure, "10", HARD_ASYMMETRIC, protocol, *seen)


def _not_periodic(run: Run, protocol: str) -> Iterator[str]:
    """How much is not periodic, and how much of it only because of the solver's tolerances."""
    noise = []
    for law in LIMITS:
        at = (*HARD_ASYMMETRIC, "response_class", "noise")
        here, tight = (run.points(law + end, *at) for end in (protocol, TIGHT))
        noise.append([1e6 * one["noise"].median().item() for one in (here, tight)])
        regular = tight["omega"][tight["response_class"].values == ResponseClass.PERIODIC]
        of_solver, counts = here["omega"].isin(regular), []
        for kind in (ResponseClass.CHAOTIC, ResponseClass.UNRESOLVED):
            hits = here["response_class"] == kind
            so = f" ({np.sum(hits & of_solver).item()} periodic with the tight solver)"
            counts.append(f"{hits.sum().item()} {kind.name.lower()}{so if protocol else ''}")
        yield f"{law}: {listed(counts)}."
    yield "Unresolved: neither a period nor an exponent positive beyond three standard errors."
    if protocol:
        loose, fine = (number(n) for n in np.max(noise, axis=0))
        so = f"by {loose} µm from tolerances alone (tight: {fine}), more where kinks pass unlocated"
        yield f"What the tight solver finds periodic, the paper's scatters: {so}."


def _histories(run: Run) -> Iterator[Figured]:
    """Figure 11."""
    (K_c, gap), histories = HARD_ASYMMETRIC, run["histories"]
    here = (histories["K_c"] == K_c) & (histories["gap"] == gap)
    laws = [law + PAPER for law in LIMITS if law + PAPER in labels_of(histories)]
    scene = swept(histories.isel(history=here.values).sel(representation=laws).load())
    if EXACT + PAPER not in labels_of(scene):
        return
    kinds = (
        f"{label} {', '.join(f'P{n}' if n else 'none' for n in periods)}"
        for label, periods in zip(labels_of(scene), late_periods(scene).T.tolist(), strict=True)
    )
    moved = [
        f"{label} at {omega:g} Hz from {periods}"
        for (omega, label), periods in moved_on(run, laws, HARD_ASYMMETRIC).items()
    ]
    so = "With the paper's tolerances a motion can leave the orbit on which its response was taken:"
    so = f" {so} {listed(moved)}." if moved else ""
    words = (
        f"Last {draw.SHOWN_PERIODS} forcing periods from rest, and spectrum (Hann window): between "
        f"the exact law's lines is what the others add. Periods to 2 % of the gap (root "
        f"mean square), by row: {'; '.join(kinds)}.{so}"
    )
    yield _figured(draw.histories_and_spectra(scene), "11", HARD_ASYMMETRIC, PAPER, words)


# Figure, the paper's words, what is counted for them, within what [Hz], from which starts.
BANDS = (
    ("6a", "superharmonic near 2", "largest amplitude", (1.2, 3.0), "rest"),
    ("6a", "RatPoly: subharmonic 11-12", "period above 1", (4.0, 30.0), "scattered"),
    ("6a", "RatPoly: peak below 0 from 22", "peak below 0", (15.0, 30.0), "scattered"),
    ("6b", "subharmonic 17-21", "period 3", (10.0, 30.0), "scattered"),
    ("6b", "subharmonic 17-21", "period 3", (10.0, 30.0), "sweep_up"),
    ("6c", "jump near 12", "largest amplitude", (0.0, 30.0), "rest"),
    ("6c", "chaos 13-15", "chaos", (10.0, 30.0), "scattered"),
    ("6c", "RatPoly: 15-18, subharmonic 21-22", "period above 1", (13.0, 30.0), "scattered"),
    ("8b", "chaos 4-5", "chaos", (3.0, 6.0), "rest"),
    ("8b", "transitions near 6 and 7", "period above 1", (5.2, 8.5), "rest"),
    ("8b", "RatPoly, arctan: after the jump", "period not 1", (10.0, 17.0), "rest"),
    ("8c", "RatPoly: larger above 20", "crosses 0", (0.0, 30.0), "rest"),
    ("9", "more behaviour 10-12", "period not 1", (9.0, 13.0), "rest"),
    ("9", "higher periods 12-20", "period above 1", (12.0, 20.0), "rest"),
    ("9", "log-arctan: beyond 20", "period not 1", (20.0, 30.0), "rest"),
)
_LAWS = ("exact", "Poly", "RatPoly", "tanh", "arctan", "log-arctan")
_BANDS_HEAD = ["Fig.", "Paper [Hz]", "Here [Hz]", *_LAWS]
_BANDS_SAY = (
    "Frequencies that the paper names, and where the same is found here with the tight solver, in "
    "a range at least as wide as the paper's; on the grid of the study, or by bisection. A dash: "
    "nowhere."
)


def band_rows(run: Run) -> list[list[str]]:
    """The paper's and our frequencies of every band that the paper names."""
    rows = [
        [place, paper, f"{counted}, start: {start}", *_found(run, place, counted, within, start)]
        for place, paper, counted, within, start in BANDS
    ]
    if "bands" in run.datasets:
        ends = run["bands"].sel(representation=[EXACT, *WEAK])
        pairs = zip(ends["period_3_low"].values, ends["period_3_high"].values, strict=True)
        three = (f"{low:.2f}-{high:.2f}" if low < high else "–" for low, high in pairs)
        jumps = (f"{omega:.2f}" for omega in ends["peak_frequency"].values)
        rows.append(["8b", "subharmonic 17-21", "period 3, bisected", *three])
        rows.append(["8b", "primary peak", "jump, bisected", *jumps])
    return sorted((row for row in rows if any(row[3:])), key=lambda row: row[0])


def _found(run: Run, place: str, counted: str, within: Band, start: str) -> Iterator[str]:
    scene, laws = SHOWN[place]
    for law in (EXACT, *laws):
        found = ""
        with suppress(NotInRunError):
            found = ranges(*frequencies(run, law, scene, counted, within, start))
        yield found.replace(" Hz", "").replace("no frequency", "–")


_TABLE_2_SAYS = (
    "Right-hand sides and processor time (this machine's) per forcing period from rest, the means "
    "over frequencies, with the paper's tolerances, step control and restarts, beside the paper's "
    "seconds for a whole diagram."
)
_COSTS = ("Right-hand sides", "Time [µs]", "Paper [s]")
_TABLE_2_HEAD = ["Law", *(word for cost in _COSTS for word in (cost, "over exact"))]


def costs(run: Run) -> tuple[list[str], list[Table]]:
    """Table 2 beside the costs of a forcing period here, and what of its factors is in the work."""
    sentences, tables = [], []
    for (grade, paper), figure in zip(TABLE_2.items(), ("Fig. 8b", "Fig. 9"), strict=True):
        nfev, seconds = (_per_period(run, grade, name) for name in ("nfev", "cpu_time"))
        if EXACT not in nfev or len(nfev) < 2:
            continue
        of = (nfev, seconds, paper)
        rows = [[a, *(number(n) for c in of for n in (c[a], c[a] / c[EXACT]))] for a in nfev]
        tables.append(Table(figure, _TABLE_2_HEAD, rows))
        tanh = next(law for law in paper if law.startswith("tanh"))
        if tanh not in nfev:
            continue
        theirs, ours = (column[EXACT] / column[tanh] for column in (paper, nfev))
        so = "is" if ours > 0.5 * theirs else "is not"
        sentences.append(
            f"{figure}: the exact law takes {theirs:.1f} times the seconds of {tanh} in the paper, "
            f"{ours:.2f} times its right-hand sides here: the factor {so} in the right-hand sides."
        )
    return sentences, tables


def _per_period(run: Run, grade: str, name: str) -> dict[str, float]:
    """Mean cost of a forcing period with the paper's solver, by law, as far as the run has it."""
    found, factor = {}, {"cpu_time": 1e6}.get(name, 1.0)
    for law in TABLE_2[grade]:
        with suppress(NotInRunError):
            cost = per_period(run, law + PAPER, TABLE_SCENES[grade], name)
            found[law] = factor * float(np.nanmean(cost))
    return found
