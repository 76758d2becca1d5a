"""The paper's words as numbers: every word has one measure and one threshold, for all claims.

Each function reads one selection of a run and gives a `Number` with its floor: of what is compared
with the exact law, the same number of another exact law; of a share, its standard error.
"""

import math
from collections.abc import Callable, Iterable

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from gapsweep.analysis.floors import floor_labels
from gapsweep.analysis.verdicts import Number, Run, Test, mean, ratio_of_sums, share
from gapsweep.response.result import ResponseClass
from gapsweep.status import Status

from .scenes import EXACT

Scene = tuple[float, str]
Band = tuple[float, float]
Bools = NDArray[np.bool_]

ALL = (0.0, 30.0)  # Hz
LINE = 0.05  # relative amplitude error: the thickness of a plotted line
MOST = 0.75  # "excellent", "agrees well": three points of four within a line
HALF = 0.5  # "captures": more of it than not
NONE = 0.1  # "captures none": a tenth at most
FEW = 0.05  # "does not occur": one frequency of twenty
_BANDS_SHOWN = 3
ALIKE = 1.1  # "nearly the same": within a tenth

NAMES = {"poly": "Poly", "ratpoly": "RatPoly", "logarctan": "log-arctan", "piecewise": "exact law"}


def named(label: str) -> str:
    """The paper's name of a representation."""
    law = label.partition("@")[0]
    if law == "piecewise-noevents":
        return "the exact law without events"
    family, _, parameter = law.partition("-")
    name = NAMES.get(family, family)
    return {"poly": f"{name}-{parameter}", "ratpoly": f"{name} {parameter}"}.get(family, name)


def listed(names: Iterable[str]) -> str:
    """Names as a list in a sentence."""
    *most, last = list(names) or ["none"]
    return f"{', '.join(most)} and {last}" if most else last


def each(
    labels: Iterable[str], says: str, number: Callable[[str], Number], op: str, limit: float
) -> list[Test]:
    """One test for each law: ``tanh: SAYS``."""
    return [Test(f"{named(label)}: {says}", number(label), op, limit) for label in labels]


def shown(tests: Iterable[Test], form: str = ".0%") -> str:
    """What such tests found: ``tanh 12%, arctan 13% and log-arctan 40%``."""
    return listed(f"{test.says.split(':')[0]} {test.number.value:{form}}" for test in tests)


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
    """Share of the exact attractors that a law has too."""
    return _of_sets(run, "recall", label, scene, band)


def f1(run: Run, label: str, scene: Scene, band: Band = ALL) -> Number:
    """Agreement of the attractor sets: what is missed counts, and what is invented."""
    return _of_sets(run, "f1", label, scene, band)


def amplitude_error(
    run: Run, label: str, scene: Scene, band: Band = ALL, start: str = "rest", q: float = MOST
) -> Number:
    """Amplitude error that a share `q` of the points stays below; without a response infinite."""

    def quantile(label: str) -> float:
        points = run.points(
            label, *scene, "amplitude_error", band=band, start=start, data="agreement"
        )
        errors = points["amplitude_error"].fillna(np.inf).values
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


def same_picture(
    run: Run,
    label: str,
    other: str,
    scene: Scene,
    where: Bools | None = None,
    resolution: float = 0.02,
) -> Number:
    """Share of the frequencies at which two laws from rest have the same peak and trough.

    The same: within a fiftieth of the gap's width, which is what a plot shows, or another share.
    """
    both = [run.points(one, *scene, "x_max", "x_min") for one in (label, other)]
    common = np.intersect1d(both[0]["omega"].values, both[1]["omega"].values)
    ours, theirs = (points.isel(point=np.isin(points["omega"], common)) for points in both)
    width = 1e-3 * sum(float(j) for j in scene[1].split("/"))
    apart = (
        abs(ours[["x_max", "x_min"]] - theirs[["x_max", "x_min"]]).to_dataarray().max("variable")
    )
    hits = apart <= resolution * width
    return share(hits if where is None else hits[where])


# --- of one law ---------------------------------------------------------------------------------


def is_class(run: Run, label: str, scene: Scene, kind: ResponseClass, band: Band = ALL) -> Number:
    """Share of the responses from rest that are of a class."""
    points = run.points(label, *scene, "response_class", band=band)
    return share(points["response_class"] == kind)


def frequencies(
    run: Run,
    label: str,
    scene: Scene,
    hits: Callable[[xr.Dataset], xr.DataArray],
    *names: str,
    band: Band = ALL,
    start: str = "rest",
) -> tuple[NDArray[np.float64], Bools]:
    """Frequencies that were asked for, and at which of them some start fulfils a condition."""
    points = run.points(label, *scene, *names, band=band, start=start)
    omega, where = np.unique(points["omega"].values, return_inverse=True)
    found = np.zeros(omega.size, dtype=bool)
    np.logical_or.at(found, where, hits(points).values)
    return omega, found


def period_3(run: Run, label: str, scene: Scene, band: Band) -> Number:
    """Share of the frequencies with scattered starts at which some start has period 3."""
    found = frequencies(
        run, label, scene, is_period_3, "period_multiple", band=band, start="scattered"
    )
    return share(found[1], found[0])


def is_period_3(points: xr.Dataset) -> xr.DataArray:
    """Whether points have period 3."""
    return points["period_multiple"] == 3


def largest(run: Run, name: str, label: str, scene: Scene, start: str = "rest") -> Number:
    """Largest value of a variable; its floor is the spread among the exact laws."""
    values = {
        one: float(run.points(one, *scene, name, start=start)[name].max())
        for one in {label, EXACT, *_floor_labels(run)}
    }
    floor = max(abs(values[one] - values[EXACT]) for one in values if one != label)
    return Number(values[label], floor)


# --- costs --------------------------------------------------------------------------------------


def work(run: Run, label: str, other: str, scene: Scene) -> Number:
    """Right-hand sides per forcing period from rest, of one law over those of another.

    The same on every machine; seconds are not. The floor is the jackknife over frequencies.
    """
    costs = [_per_period(run, one, scene, "nfev") for one in (label, other)]
    return ratio_of_sums(*costs)


def seconds(run: Run, label: str, other: str, scene: Scene) -> str:
    """Processor time per forcing period, of one law over that of another: a text, no test."""
    return f"{ratio_of_sums(*(_per_period(run, one, scene, 'cpu_time') for one in (label, other)))}"


def _per_period(run: Run, label: str, scene: Scene, name: str) -> NDArray[np.float64]:
    points = run.points(label, *scene, name, "t_simulated")
    return np.asarray(points[name] / (points["t_simulated"] * points["omega"]))
