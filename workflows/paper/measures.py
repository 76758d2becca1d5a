"""The paper's words as numbers: a glossary, the paper's figures, and what is measured in them.

A figure states its case, laws and initial condition once; its methods are tables of quantities by
law. Numbers carry a numerical uncertainty: of what is compared with the exact law, the same number
of the exact law with tighter tolerances or from 1 nm away; of a share, its standard error.
"""

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from gapsweep.analysis.agreement.self_agreement import floor_labels
from gapsweep.analysis.claims import NotInRunError, Number, Run, mean, ratio_of_sums, share
from gapsweep.analysis.spectra import SAMPLES_PER_PERIOD
from gapsweep.model.labels import Representation
from gapsweep.response.result import ResponseClass
from gapsweep.status import Status

from .language import At, Quantity
from .refined import FINEST, runs
from .scenes import EXACT, NO_EVENTS, RELEASED, STARTS, width

Scene = tuple[float, str]
Band = tuple[float, float]
Bools = NDArray[np.bool_]
OfLaw = Callable[[At, str], Number]

# The glossary.
LINE = 0.05  # "agrees": the thickness of a plotted line, as a share of the amplitude
THREE_QUARTERS = 0.75  # "excellent", "agrees well": so many points are within a line
HALF = 0.5  # "captures", "most": more of it than not
TENTH = 0.1  # "to varying degrees": at least; "captures none": at most
TWENTIETH = 0.05  # "does not occur": in fewer
MUCH = 1.5  # "much larger": by half
SAME_SIZE = 1.25  # "correct-size": within a quarter
ALIKE = 1.1  # "nearly the same": within a tenth
ABOUT = 1.25  # "about 1.5": within a quarter
SLIGHTLY = 0.5  # Hz; "slightly": by less than a region
REGION = 5  # "a region": so many steps of the grid, half a hertz
COMPARABLE = 10.0**0.5  # "can be comparable": within half a decade
AS_DRAWN = 0.02  # "minimal", "agree well" in a diagram: this share of the gap is what a plot shows
ALL = (0.0, 30.0)  # Hz
_BANDS_SHOWN = 3
_LEAST = 1e-12  # of the gap's width: distances below this are rounding

NAMES = {
    EXACT: "exact law", NO_EVENTS: "without events", "truth": "reference",
    "logarctan": "log-arctan", "@paper": " (rtol 1e-4)", "@finer": " (rtol 1e-6)",
    "@half": " at half the tolerance", "@jitter": " from 1 nm away",
}  # fmt: skip


def named(label: str) -> str:
    """The paper's name of a representation, with its protocol."""
    one = Representation(label)
    family = one.family or one.law
    fits = {"poly": f"Poly-{one.parameter}", "ratpoly": f"RatPoly {one.parameter}"}
    own = one.law if one.protocol and "tan" in family else NAMES.get(family, family)
    return NAMES.get(one.law, fits.get(family, own)) + NAMES.get(f"@{one.protocol}", "")


def listed(names: Iterable[str]) -> str:
    """Names as a list in a sentence."""
    *most, last = list(names) or ["none"]
    return f"{', '.join(most)} and {last}" if most else last


def ranges(omega: NDArray[np.float64], hits: Bools) -> str:
    """Frequencies as the bands that they make on their grid: ``15.8-27.6 Hz``."""
    bands = runs(hits)
    if not bands:
        return "no frequency"
    widest = sorted(sorted(bands, key=lambda i_j: i_j[0] - i_j[1])[:_BANDS_SHOWN])
    shown = [f"{omega[i]:g}" if j == i + 1 else f"{omega[i]:g}-{omega[j - 1]:g}" for i, j in widest]
    more = f" and {len(bands) - len(shown)} narrower" if len(bands) > len(shown) else ""
    return f"{', '.join(shown)} Hz{more}"


def solved(at: At, label: str) -> str:
    """A label; with the setting of the contact force if the paper's solver locates its contacts."""
    return label + at["force"] if label == f"{EXACT}@paper" else label


# --- quantities of no figure ----------------------------------------------------------------------


def constants(what: str, numbers: dict[str, float | tuple[float, float]]) -> Quantity:
    """Numbers that no run changes, or numbers and their uncertainties."""

    def part(name: str, number: float | tuple[float, float]) -> tuple[str, Callable[[At], Number]]:
        return name, lambda _: Number(*np.atleast_1d(number).tolist())

    return Quantity(what, tuple(part(*one) for one in numbers.items()))


def of_dataset(
    dataset: str,
    what: str,
    name: str,
    reduced: Callable[[xr.DataArray], Any] = float,
    form: str = ".3g",
    **where: Any,
) -> Quantity:
    """A variable of a dataset, one number for each combination of the labels in tuples."""
    several = {dim: labels for dim, labels in where.items() if isinstance(labels, tuple)}

    def part(labels: tuple[Any, ...]) -> tuple[str, Callable[[At], Number]]:
        chosen = dict(zip(several, labels, strict=True))

        def read(at: At) -> Number:
            settings = {dim: at[dim] for dim, label in where.items() if label is None}
            found = at.run.select(dataset, **{**where, **chosen, **settings})[name]
            return Number(float(reduced(found)))

        words = (str(x) if isinstance(x, str) else f"{dim} {x:g}" for dim, x in chosen.items())
        return ", ".join(words), read

    return Quantity(what, tuple(part(labels) for labels in product(*several.values())), form)


def slope(rungs: xr.DataArray) -> float:
    """Slope of a log-log line over the degrees."""
    return float(np.polyfit(np.log(rungs["degree"].values), np.log(rungs.values), 1)[0])


def steepest(rungs: xr.DataArray) -> float:
    """The largest ratio of neighbours."""
    return float(np.max(rungs.values[1:] / rungs.values[:-1]))


class Median(Number):
    """A median over frequencies; the difference of two is the median of the differences."""

    def __sub__(self, other: Number) -> Number:
        pairs = self._pairs(other)
        return median(pairs[0] - pairs[1], self.of) if pairs else super().__sub__(other)


def median(values: NDArray[np.float64], of: NDArray[np.float64] | None) -> Median:
    """A median, and half of its 95 % interval (a sign test's) as uncertainty."""
    if values.size < 4:
        raise NotInRunError("too few motions of that kind")
    n, spread = values.size, math.sqrt(values.size)
    low, high = np.sort(values)[[int(0.5 * n - spread), int(0.5 * n + spread)]]
    return Median(float(np.median(values)), 0.5 * float(high - low), n, values, of)


def distance(one: str, other: str, chaotic: bool | None = None) -> Quantity:
    """Distance of two motions in the fourth forcing period, in widths of the gap.

    The median over frequencies of the root mean square; of the frequencies at which the exact
    law's response is chaotic, or periodic, if that is given.
    """
    kinds = {None: "", True: ", chaotic frequencies", False: ", periodic frequencies"}

    def read(at: At) -> Number:
        motions = at.run.select("motions", start=at["start"])
        x = motions["x"].transpose("representation", "omega", "sample")
        ours, theirs = (x.sel(representation=solved(at, label)) for label in (one, other))
        apart = (ours - theirs) / motions["width"]
        rms = np.sqrt((apart**2).mean("sample").values)
        found = np.full(rms.size, True)
        if chaotic is not None:
            wanted = ResponseClass.CHAOTIC if chaotic else ResponseClass.PERIODIC
            found = (motions["response_class"] == wanted).values
        decades = np.log10(np.maximum(rms, _LEAST))
        return median(decades[found], motions["omega"].values[found])

    name = f"{named(one)} from {named(other)}{kinds[chaotic]}"
    return Quantity("distance after 4 periods, gap widths", ((name, read),), ".2g", log=True)


# --- what is looked for in a response -------------------------------------------------------------


def swings(points: xr.Dataset) -> xr.DataArray:
    """How many swings a response has that are more than a line of its amplitude."""
    extrema = points["extrema"].transpose("point", "extremum").values
    lines = LINE * points["amplitude"].values
    found = [_swings(x[np.isfinite(x)], line) for x, line in zip(extrema, lines, strict=True)]
    return xr.DataArray(np.array(found, dtype=int), dims="point")


def _swings(extrema: NDArray[np.float64], least: float) -> int:
    """Turning points that are left when swings of less than `least` are not counted."""
    count, way, last = 0, 0.0, extrema[0] if extrema.size else 0.0
    for x in [*extrema, *extrema[:2]]:  # the motion repeats
        if abs(x - last) >= least and (x - last) * way <= 0.0:
            count, way, last = count + 1, x - last, x
        elif (x - last) * way > 0.0:
            last = x
    return count - 1


# The variables that tell, and the condition on them.
KINDS: dict[str, tuple[tuple[str, ...], Callable[[xr.Dataset], xr.DataArray]]] = {
    "periodic": (("response_class",), lambda p: p["response_class"] == ResponseClass.PERIODIC),
    "chaos": (("response_class",), lambda p: p["response_class"] == ResponseClass.CHAOTIC),
    "period 3": (("period_multiple",), lambda p: p["period_multiple"] == 3),
    "period above 1": (("period_multiple",), lambda p: p["period_multiple"] > 1),
    "period not 1": (("period_multiple",), lambda p: p["period_multiple"] != 1),
    "ringing": (("extrema", "amplitude"), lambda p: swings(p) > 2),
    "nonlinear behaviour": (
        ("period_multiple", "extrema", "amplitude"),
        lambda p: (p["period_multiple"] != 1) | (swings(p) > 2),
    ),
    "largest amplitude": (("amplitude",), lambda p: p["amplitude"] == p["amplitude"].max()),
    "peak below 0": (("x_max",), lambda p: p["x_max"] < 0.0),
    "negative mean": (
        ("x_max", "x_min", "amplitude"),
        lambda p: 0.5 * (p["x_max"] + p["x_min"]) < -TENTH * p["amplitude"],
    ),
    "crosses 0": (("x_max", "x_min"), lambda p: p["x_max"] * p["x_min"] < 0.0),
}


def starting(run: Run, start: str) -> Bools:
    """Which initial conditions are one of the paper's, ``scattered``, ``any`` or a sweep."""
    responses, starts = run["responses"], run.starts
    fixed = responses["start"].values == "fixed"
    known = {
        name: fixed
        & np.isclose(responses["x_0"].values, x_0, atol=1e-12)
        & (responses["v_0"].values == v_0)
        for name, (x_0, v_0) in STARTS.items()
    }
    scattered = fixed & ~np.any(list(known.values()), axis=0)
    found: dict[str, Bools] = {**starts, **known, "scattered": scattered}
    return found[start]


# --- the paper's figures --------------------------------------------------------------------------


@dataclass(frozen=True)
class Table:
    """A quantity by law: ``table["tanh-1e4"]``, ``table["poly-13", "tanh-1e4"]``."""

    what: str
    number: OfLaw
    form: str = ".3g"

    def __getitem__(self, labels: str | tuple[str, ...]) -> Quantity:
        def part(label: str) -> tuple[str, Callable[[At], Number]]:
            return named(label), lambda at: self.number(at, solved(at, label))

        of = (labels,) if isinstance(labels, str) else labels
        return Quantity(self.what, tuple(part(label) for label in of), self.form)


@dataclass(frozen=True)
class Figure:
    """A figure of the paper.

    Attributes
    ----------
    gap : str
        Distances of both walls [mm]; empty: the paper does not state it.
    start : str
        A key of `Run.starts`, or `RELEASED`, in place of which every diagram is read from rest too.
    """

    place: str
    K_c: float
    gap: str
    start: str = RELEASED

    @property
    def words(self) -> str:
        starts = {"scattered": "16 initial conditions", "any": "all initial conditions"}
        gap = f"{self.gap} mm" if self.gap else "not stated"
        start = starts.get(self.start, f"x_0 = {self.start}, v_0 = 0")
        return f"K_c = {self.K_c:g} N/m, gap {gap}, {start}"

    def scene(self, at: At) -> Scene:
        return self.K_c, self.gap or at["gap"]

    def start_of(self, at: At) -> str:
        return at["start"] if self.start == RELEASED else self.start

    def table(self, what: str, number: OfLaw, form: str = ".3g") -> Table:
        return Table(f"{self.place}, {what}", number, form)

    def points(self, at: At, label: str, *names: str, band: Band = ALL, **more: Any) -> xr.Dataset:
        return at.run.points(
            label,
            *self.scene(at),
            *names,
            band=band,
            start=starting(at.run, self.start_of(at)),
            **more,
        )

    # Compared with the exact law.

    def _errors(self, at: At, label: str, band: Band) -> tuple[xr.Dataset, NDArray[np.float64]]:
        """Points of a law, and relative errors of their amplitudes, infinite where none is."""
        status = at.run.scene("responses", label, *self.scene(at), "status")["status"]
        ours, exact = (
            at.run.scene("responses", one, *self.scene(at), "amplitude")["amplitude"]
            for one in (label, EXACT)
        )
        least = 0.0
        if at["share"] == "gap":
            least = 0.5 * width(self.scene(at))
        error = abs(ours - exact.values) / np.maximum(exact.values, least)
        found = xr.Dataset({"error": error, "asked": status}).sel(omega=slice(*band))
        found = found.isel(initial_condition=starting(at.run, self.start_of(at)))
        found = found.stack(point=("omega", "initial_condition"), create_index=False)
        found = found.isel(point=found["asked"].values != Status.NOT_REQUESTED)
        if not found.sizes["point"]:
            raise NotInRunError(f"no points of {label} at {self.place}")
        return found, found["error"].fillna(np.inf).values

    def error(self, band: Band = ALL, q: float = THREE_QUARTERS) -> Table:
        """Amplitude error that a share `q` of the points stays below."""

        def quantile(at: At, label: str) -> float:
            return float(np.quantile(self._errors(at, label, band)[1], q, method="higher"))

        def number(at: At, label: str) -> Number:
            floor = max((quantile(at, one) for one in _floor_labels(at.run)), default=math.nan)
            return Number(quantile(at, label), floor)

        shares = {THREE_QUARTERS: "of 3 in 4", HALF: "in the median"}
        return self.table(f"relative amplitude error {shares[q]}{_hertz(band)}", number, ".1%")

    def right(self, band: Band = ALL) -> Table:
        """Share of the frequencies with the exact class and amplitude."""

        def number(at: At, label: str) -> Number:
            points, errors = self._errors(at, label, band)
            same = self.points(at, label, "class_agreement", band=band, data="agreement")
            return share(
                (errors <= LINE) & (same["class_agreement"].values == 1.0), points["omega"]
            )

        says = f"exact class, and the exact amplitude within 5 % of it{_hertz(band)}"
        return self.table(f"frequencies with the {says}", number, ".0%")

    def same_class(self, band: Band) -> Table:
        """Share of the frequencies with the exact class."""

        def number(at: At, label: str) -> Number:
            return mean(self.points(at, label, "class_agreement", band=band, data="agreement")
                        ["class_agreement"])  # fmt: skip

        return self.table(f"frequencies of the exact class{_hertz(band)}", number, ".0%")

    def of_sets(self, name: str, band: Band = ALL) -> Table:
        """Mean of a metric of attractor sets, at the frequencies with scattered starts."""

        def number(at: At, label: str) -> Number:
            status = at.run.scene("responses", label, *self.scene(at), "status")["status"]
            asked = status.isel(initial_condition=starting(at.run, "scattered"))
            asked = (asked != Status.NOT_REQUESTED).any("initial_condition")
            values = at.run.scene("agreement", label, *self.scene(at), name)[name]
            return mean(values.isel(omega=asked.values).sel(omega=slice(*band)))

        says = {"recall": "exact attractors found", "f1": "F1 of the attractor sets"}[name]
        return self.table(f"{says}{_hertz(band)}", number, ".0%" if name == "recall" else ".2f")

    def recall(self, band: Band = ALL) -> Table:
        return self.of_sets("recall", band)

    def f1(self, band: Band = ALL) -> Table:
        return self.of_sets("f1", band)

    # Of one law.

    def share(self, kind: str, band: Band = ALL) -> Table:
        """Share of the responses that are of a kind."""
        return self.table(
            f"responses with {kind}{_hertz(band)}",
            lambda at, label: share(self._hits(at, label, kind, band)),
            ".0%",
        )

    def count(self, kind: str, band: Band = ALL) -> Table:
        """At how many frequencies some response is of a kind."""
        return self.table(
            f"frequencies with {kind}{_hertz(band)}",
            lambda at, label: Number(float(self._frequencies(at, label, kind, band).sum())),
            ".0f",
        )

    def share_of_frequencies(self, kind: str, band: Band = ALL) -> Table:
        """Share of the frequencies at which some response is of a kind."""
        return self.table(
            f"share of the frequencies with {kind}{_hertz(band)}",
            lambda at, label: share(self._frequencies(at, label, kind, band)),
            ".0%",
        )

    def _hits(self, at: At, label: str, kind: str, band: Band) -> xr.DataArray:
        """Which responses are of a kind."""
        names, is_kind = KINDS[kind]
        points = self.points(at, label, *names, band=band)
        return is_kind(points).assign_coords(omega=points["omega"])

    def _frequencies(self, at: At, label: str, kind: str, band: Band) -> xr.DataArray:
        """At which frequencies some response is of a kind."""
        hits = self._hits(at, label, kind, band)
        omega, where = np.unique(hits["omega"].values, return_inverse=True)
        return xr.DataArray(np.bincount(where, hits.values) > 0.0, {"omega": omega}, "omega")

    def of_points(
        self,
        what: str,
        names: tuple[str, ...],
        reduced: Callable[[xr.Dataset], Any],
        form: str = ".3g",
        band: Band = ALL,
    ) -> Table:
        """A number of all responses; the exact laws differ by its uncertainty if it is a float."""

        def number(at: At, label: str) -> Number:
            def value(one: str) -> Any:
                return reduced(self.points(at, one, *names, band=band))

            found = value(label)
            if isinstance(found, Number):
                return found
            itself, *others = (float(value(one)) for one in (EXACT, *_floor_labels(at.run)))
            apart = np.abs(np.array(others) - itself) / (abs(itself) or 1.0)
            return Number(float(found), abs(float(found)) * float(np.max(apart, initial=0.0)))

        return self.table(f"{what}{_hertz(band)}", number, form)

    def static(self, what: str, name: str, form: str = ".3g") -> Table:
        """A number of the force, which nothing rounds or samples."""

        def number(at: At, label: str) -> Number:
            found = at.run.scene("static", label, *self.scene(at), name)[name]
            return Number(float(found))

        return self.table(what, number, form)

    def shift(self, table: Table) -> Table:
        """How far a number of each law is from the exact law's."""

        def number(at: At, label: str) -> Number:
            apart = table.number(at, label) - table.number(at, EXACT)
            return Number(abs(apart.value), apart.floor)

        return Table(f"{table.what}, off the exact one", number, table.form)

    def bisected(self, what: str, **ends: float) -> Table:
        """A sum of ends of bands, each times a factor [Hz]; every one is known within `FINEST`."""

        def number(at: At, label: str) -> Number:
            found = at.run.select("bands", representation=label, start=at["start"])
            return Number(sum(float(found[end]) * n for end, n in ends.items()), FINEST)

        return self.table(f"{what} [Hz]", number, ".2f")


def _hertz(band: Band) -> str:
    return "" if band == ALL else f", {band[0]:g}-{band[1]:g} Hz"


def _floor_labels(run: Run) -> list[str]:
    responses = run["responses"]
    labels = [str(label) for label in responses["representation"].values]
    return floor_labels(responses.attrs["study_json"], labels)


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


# --- costs ----------------------------------------------------------------------------------------


def cost(what: str, name: str, of: dict[str, tuple[str, str, Scene]]) -> Quantity:
    """Cost of a forcing period of one law over that of another, by name; all initial conditions.

    Its uncertainty is the jackknife over frequencies.
    """

    def part(label: str, other: str, scene: Scene) -> Callable[[At], Number]:
        return lambda at: ratio_of_sums(
            *(per_period(at.run, one, scene, name) for one in (label, other))
        )

    return Quantity(what, tuple((says, part(*one)) for says, one in of.items()))


def per_period(run: Run, label: str, scene: Scene, name: str) -> NDArray[np.float64]:
    """A cost of every response, per forcing period."""
    points = run.points(label, *scene, name, "t_simulated", start="any")
    return np.asarray(points[name] / (points["t_simulated"] * points["omega"]))
