"""The paper's words as numbers: the words that recur have one measure and one threshold.

Each function reads one selection of a run and gives a `Number` with its floor: of what is compared
with the exact law, the same number of another exact law; of a share, its standard error.
"""

import math
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from itertools import product

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from gapsweep.analysis.floors import floor_labels
from gapsweep.analysis.histories import SAMPLES_PER_PERIOD
from gapsweep.analysis.verdicts import NotInRunError, Number, Run, Test, mean, ratio_of_sums, share
from gapsweep.model.labels import law_of
from gapsweep.response.result import ResponseClass
from gapsweep.status import Status

from .scenes import EXACT

Scene = tuple[float, str]
Band = tuple[float, float]
Bools = NDArray[np.bool_]
OfLaw = Callable[[str], Number]

ALL = (0.0, 30.0)  # Hz
LINE = 0.05  # relative amplitude error: the thickness of a plotted line
THREE_QUARTERS = 0.75  # "excellent", "agrees well": of the points, within a line
HALF = 0.5  # "captures", "most": more of it than not
TENTH = 0.1  # "captures none": at most
TWENTIETH = 0.05  # "does not occur": of the frequencies
ALIKE = 1.1  # "nearly the same": within a tenth
AS_DRAWN = 0.02  # of the gap's width: what a plot shows
_BANDS_SHOWN = 3

NAMES = {"poly": "Poly", "ratpoly": "RatPoly", "logarctan": "log-arctan", "piecewise": "exact law"}


def named(label: str) -> str:
    """The paper's name of a representation."""
    law = law_of(label)
    if law == "piecewise-noevents":
        return "the exact law without events"
    family, _, parameter = law.partition("-")
    name = NAMES.get(family, family)
    return {"poly": f"{name}-{parameter}", "ratpoly": f"{name} {parameter}"}.get(family, name)


def listed(names: Iterable[str]) -> str:
    """Names as a list in a sentence."""
    *most, last = list(names) or ["none"]
    return f"{', '.join(most)} and {last}" if most else last


def each(labels: Iterable[str], says: str, number: OfLaw, op: str, limit: float) -> list[Test]:
    """One test for each law: ``tanh: SAYS``."""
    return [Test(f"{named(label)}: {says}", number(label), op, limit) for label in labels]


def shown(tests: Iterable[Test], form: str = ".0%") -> str:
    """What such tests found: ``tanh 12%, arctan 13% and log-arctan 40%``."""
    return listed(f"{test.says.split(':')[0]} {test.number.value:{form}}" for test in tests)


def by_law(numbers: Mapping[str, Number], form: str = ".0%") -> str:
    """The same of numbers by label."""
    return listed(f"{named(label)} {number.value:{form}}" for label, number in numbers.items())


def ranges(omega: NDArray[np.float64], hits: Bools) -> str:
    """Frequencies as the bands that they make on their grid: ``15.8-27.6 Hz``."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], hits.astype(int), [0]])))
    bands = [(int(i), int(j)) for i, j in edges.reshape(-1, 2)]
    if not bands:
        return "no frequency"
    widest = sorted(sorted(bands, key=lambda i_j: i_j[0] - i_j[1])[:_BANDS_SHOWN])
    shown = [f"{omega[i]:g}" if j == i + 1 else f"{omega[i]:g}-{omega[j - 1]:g}" for i, j in widest]
    more = f" and {len(bands) - len(shown)} narrower" if len(bands) > len(shown) else ""
    return f"{', '.join(shown)} Hz{more}"


# --- compared with the exact law ----------------------------------------------------------------


def _floor_labels(run: Run) -> list[str]:
    responses = run["responses"]
    labels = [str(label) for label in responses["representation"].values]
    return floor_labels(responses.attrs["study_json"], labels)


def _of_sets(run: Run, name: str, label: str, scene: Scene, band: Band) -> Number:
    """Mean of a metric of attractor sets, at the frequencies with scattered starts."""
    status = run.scene("responses", label, *scene, "status")["status"]
    asked = (status != Status.NOT_REQUESTED).isel(initial_condition=run.starts["scattered"])
    values = run.scene("agreement", label, *scene, name)[name]
    return mean(values.isel(omega=asked.any("initial_condition").values).sel(omega=slice(*band)))


def recall(run: Run, label: str, scene: Scene, band: Band = ALL) -> Number:
    """Share of the exact attractors that a law has too, the mean over frequencies."""
    return _of_sets(run, "recall", label, scene, band)


def recall_pooled(run: Run, label: str, scene: Scene) -> Number:
    """The same of the attractors of all frequencies together, as the report's map shows it."""
    pooled = run.scene("agreement", label, *scene, "recall_pooled")["recall_pooled"]
    return mean(pooled.sel(regime="all"))


def f1(run: Run, label: str, scene: Scene, band: Band = ALL) -> Number:
    """Agreement of the attractor sets: what is missed counts, and what is invented."""
    return _of_sets(run, "f1", label, scene, band)


def amplitude_error(
    run: Run,
    label: str,
    scene: Scene,
    band: Band = ALL,
    start: str = "rest",
    q: float = THREE_QUARTERS,
) -> Number:
    """Amplitude error that a share `q` of the points stays below; without a response infinite."""

    def quantile(label: str) -> float:
        name = "amplitude_error"
        points = run.points(label, *scene, name, band=band, start=start, data="agreement")
        errors = points[name].fillna(np.inf).values
        return float(np.quantile(errors, q, method="higher"))

    floor = max((quantile(exact) for exact in _floor_labels(run)), default=math.nan)
    return Number(quantile(label), floor)


def right(run: Run, label: str, scene: Scene, band: Band = ALL) -> Number:
    """Share of the frequencies at which a law from rest has the exact class and amplitude."""
    same = run.points(label, *scene, "class_agreement", band=band, data="agreement")
    ours, exact = (
        run.points(one, *scene, "amplitude", band=band).set_index(point="omega")["amplitude"]
        for one in (label, EXACT)
    )
    exact = exact.sel(point=ours["point"])
    hits = abs(ours - exact) <= LINE * exact
    return share(hits.values & (same["class_agreement"].values == 1.0), same["omega"])


def mean_of(run: Run, name: str, label: str, scene: Scene, band: Band = ALL) -> Number:
    """Mean of a metric that is 1 where a response from rest agrees with the exact law."""
    return mean(run.points(label, *scene, name, band=band, data="agreement")[name])


def width(scene: Scene) -> float:
    """Width of the gap [m]."""
    return 1e-3 * sum(float(j) for j in scene[1].split("/"))


def same_picture(
    run: Run,
    label: str,
    other: str,
    scene: Scene,
    where: Bools | None = None,
    resolution: float = AS_DRAWN,
) -> Number:
    """Share of the frequencies at which two laws from rest have the same peak and trough.

    The same: within a fiftieth of the gap's width, which is what a plot shows, or another share.
    """
    both = [run.points(one, *scene, "x_max", "x_min") for one in (label, other)]
    common = np.intersect1d(both[0]["omega"].values, both[1]["omega"].values)
    ours, theirs = (points.isel(point=np.isin(points["omega"], common)) for points in both)
    ends = ["x_max", "x_min"]
    apart = abs(ours[ends] - theirs[ends]).to_dataarray().max("variable")
    hits = apart <= resolution * width(scene)
    return share(hits if where is None else hits[where])


# --- of one motion ------------------------------------------------------------------------------


def late_periods(histories: xr.Dataset) -> NDArray[np.int64]:
    """Forcing periods after which the ends of histories repeat, as far as a plot shows; 0: none.

    The smallest number after which a motion is off its mean there by no more than `AS_DRAWN` of
    the gap's width (root mean square).

    Returns
    -------
    ndarray of int, shape (n_histories, n_representations)
    """
    x = histories["x"].sel(part="steady").transpose("history", "representation", "sample").values
    widths, counts = (histories["j_1"] + histories["j_2"]).values, histories["n_periods"].values
    return np.array(
        [
            [_repeats(motion[: n * SAMPLES_PER_PERIOD], AS_DRAWN * width) for motion in motions]
            for motions, width, n in zip(x, widths, counts.tolist(), strict=True)
        ]
    )


def _repeats(motion: NDArray[np.float64], near: float) -> int:
    periods = motion.reshape(-1, SAMPLES_PER_PERIOD)
    for n in range(1, max(len(periods) // 2, 1) + 1):
        alike = periods[len(periods) % n :].reshape(-1, n, SAMPLES_PER_PERIOD)
        if np.sqrt(np.mean(alike.var(axis=0))) <= near:
            return n
    return 0


def moved_on(run: Run, labels: Iterable[str], scene: Scene) -> dict[tuple[float, str], str]:
    """Motions from rest that end, in their histories, on another orbit than their response.

    Another: peak or trough differ as a plot shows, and the response was taken before the history's
    last part begins.

    Returns
    -------
    dict
        From frequency [Hz] and label to the periods of both, in words.
    """
    if "histories" not in run.datasets:
        return {}
    histories, found = run["histories"], {}
    names = ("K_c", "gap", "x_0", "v_0")
    asked = zip(*(histories[name].values.tolist() for name in names), strict=True)
    here = np.array([each == (*scene, 0.0, 0.0) for each in asked])
    known = [label for label in labels if label in histories["representation"].values]
    histories = histories.isel(history=here).sel(representation=known).load()
    periods = late_periods(histories)
    for (h, omega), (r, label) in product(enumerate(histories["omega"].values), enumerate(known)):
        one = histories.isel(history=h, representation=r)
        last = one["x"].sel(part="steady")
        ends = [float(last.max()), float(last.min())]
        with suppress(NotInRunError):
            what = ("x_max", "x_min", "t_simulated", "period_multiple")
            response = run.points(label, *scene, *what, band=(omega, omega)).isel(point=0)
            apart = np.abs(response[["x_max", "x_min"]].to_dataarray() - ends).max()
            is_earlier = response["t_simulated"] <= one["t_end"] - one["n_periods"] / omega
            if is_earlier and apart > AS_DRAWN * width(scene):
                early = response["period_multiple"].item()
                found[float(omega), label] = f"P{early} to P{periods[h, r]}".replace("P0", "none")
    return found


# --- of one law ---------------------------------------------------------------------------------


# What is looked for in a response: the variables that tell, and the condition on them.
KINDS: dict[str, tuple[tuple[str, ...], Callable[[xr.Dataset], xr.DataArray]]] = {
    "periodic": (("response_class",), lambda p: p["response_class"] == ResponseClass.PERIODIC),
    "chaos": (("response_class",), lambda p: p["response_class"] == ResponseClass.CHAOTIC),
    "period 3": (("period_multiple",), lambda p: p["period_multiple"] == 3),
    "period above 1": (("period_multiple",), lambda p: p["period_multiple"] > 1),
    "period not 1": (("period_multiple",), lambda p: p["period_multiple"] != 1),
    "ringing": (("n_extrema",), lambda p: p["n_extrema"] > 2),
    "nonlinear": (
        ("period_multiple", "n_extrema"),
        lambda p: (p["period_multiple"] != 1) | (p["n_extrema"] != 2),
    ),
    "largest amplitude": (("amplitude",), lambda p: p["amplitude"] == p["amplitude"].max()),
    "peak below 0": (("x_max",), lambda p: p["x_max"] < 0.0),
    "crosses 0": (("x_max", "x_min"), lambda p: p["x_max"] * p["x_min"] < 0.0),
}


def _hits(
    run: Run, label: str, scene: Scene, kind: str, band: Band = ALL, start: str = "rest"
) -> xr.DataArray:
    """Which responses of a law are of a kind."""
    names, is_kind = KINDS[kind]
    return is_kind(run.points(label, *scene, *names, band=band, start=start))


def share_of(
    run: Run, label: str, scene: Scene, kind: str, band: Band = ALL, start: str = "rest"
) -> Number:
    """Share of the responses of a law that are of a kind."""
    return share(_hits(run, label, scene, kind, band, start))


def frequencies(
    run: Run, label: str, scene: Scene, kind: str, band: Band = ALL, start: str = "rest"
) -> tuple[NDArray[np.float64], Bools]:
    """Frequencies that were asked for, and at which of them some response is of a kind."""
    responses = _hits(run, label, scene, kind, band, start)
    omega, where = np.unique(responses["omega"].values, return_inverse=True)
    found = np.zeros(omega.size, dtype=bool)
    np.logical_or.at(found, where, responses.values)
    return omega, found


def share_of_frequencies(
    run: Run, label: str, scene: Scene, kind: str, band: Band = ALL, start: str = "rest"
) -> Number:
    """Share of the frequencies at which some response is of a kind."""
    omega, found = frequencies(run, label, scene, kind, band, start)
    return share(found, omega)


def largest(run: Run, name: str, label: str, scene: Scene, start: str = "rest") -> Number:
    """Largest value of a variable."""
    return of_law(
        run,
        label,
        lambda one: Number(float(run.points(one, *scene, name, start=start)[name].max())),
    )


def of_law(run: Run, label: str, number: OfLaw) -> Number:
    """A number of a law; its floor is the spread of the same number among the exact laws."""
    itself, *others = (number(one).value for one in (EXACT, *_floor_labels(run)))
    floor = float(np.max(np.abs(np.array(others) - itself), initial=0.0))
    return Number(number(label).value, floor)


def larger_over_smaller(one: Number, other: Number) -> Number:
    """How far two numbers are apart, as a ratio."""
    return one / other if one.value > other.value else other / one


# --- costs --------------------------------------------------------------------------------------


def work(run: Run, label: str, other: str, scene: Scene) -> Number:
    """Right-hand sides per forcing period from rest, of one law over those of another.

    The same on every machine; seconds are not. The floor is the jackknife over frequencies.
    """
    costs = [per_period(run, one, scene, "nfev") for one in (label, other)]
    return ratio_of_sums(*costs)


def seconds(run: Run, label: str, other: str, scene: Scene) -> str:
    """Processor time per forcing period, of one law over that of another: a text, no test."""
    return f"{ratio_of_sums(*(per_period(run, one, scene, 'cpu_time') for one in (label, other)))}"


def per_period(run: Run, label: str, scene: Scene, name: str) -> NDArray[np.float64]:
    """A cost of every response from rest, per forcing period."""
    points = run.points(label, *scene, name, "t_simulated")
    return np.asarray(points[name] / (points["t_simulated"] * points["omega"]))
