"""``ds.gapsweep``: plots and a summary of any selection of a dataset.

`gapsweep.open`, `gapsweep.run`, `gapsweep.query` and `gapsweep.basins` bring it along. With plain
``xarray.open_dataset``, ``import gapsweep.report.accessor`` once.
"""

from collections.abc import Callable
from functools import wraps
from typing import TYPE_CHECKING, Any, Concatenate, ParamSpec

import numpy as np
import xarray as xr

from gapsweep.analysis.datasets.tracks import with_tracks
from gapsweep.analysis.dimensions import selected
from gapsweep.errors import DatasetError
from gapsweep.report import backdrop, contacts, drawing, dynamics, maps, marks, risk_figures
from gapsweep.report import branch_lines as of_branches
from gapsweep.report.continued import with_absolute
from gapsweep.report.drawing import labels_of
from gapsweep.report.dynamics import CURVES, WORDS
from gapsweep.report.labelled import axes_of, axis_of, finished, loglog, scene_along, titled
from gapsweep.report.losses import force_loop, with_losses
from gapsweep.report.rows import to_csv
from gapsweep.report.scales import axis_label
from gapsweep.report.selection import missing_variable, scene
from gapsweep.report.style import colour
from gapsweep.report.summary import as_html, as_text
from gapsweep.study.grid import COORDINATE
from gapsweep.variables import to_dataframe

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_RIM, _DOT = 5.0, 3.0  # points: dots of the law behind, and of the law in front


P = ParamSpec("P")


def _figure(
    draw: "Callable[Concatenate[xr.Dataset, P], Axes]",
) -> "Callable[Concatenate[GapsweepAccessor, P], Axes]":
    """A method of the accessor that calls a plotting function with the accessor's dataset."""

    @wraps(draw)
    def method(self: "GapsweepAccessor", /, *args: P.args, **kwargs: P.kwargs) -> "Axes":
        return draw(self._dataset, *args, **kwargs)

    return method


class GapsweepAccessor:
    """Plots of a dataset, as ``ds.gapsweep.bifurcation(K_c=1.4e4, gap="0.4/0.4")``.

    Every plot takes `ax`, the axes to draw into (new ones if None), and selects by coordinate:
    a value, a list, or for numbers a slice that includes both ends. A plot without the data it
    needs raises a `gapsweep.DatasetError` that names them. A notebook shows ``ds.gapsweep`` as
    the contents of the dataset and the origin of its points.
    """

    def __init__(self, dataset: xr.Dataset) -> None:
        self._dataset = dataset

    def __repr__(self) -> str:
        return as_text(self._dataset)

    def _repr_html_(self) -> str:
        return as_html(self._dataset)

    def with_absolute(self) -> xr.Dataset:
        """The responses with `absolute_max` and `absolute_min` [m] of oscillators on a moving base.

        Displacements of a response are relative to the base. Every response is simulated once more
        from its section.
        """
        return with_absolute(self._dataset)

    def with_losses(self) -> xr.Dataset:
        """The responses with `energy_lost` [J], which every contact loses per forcing period.

        Every response is simulated once more from its section. Every plot of a number draws it, as
        ``ds.gapsweep.with_losses().gapsweep.frequency_response("energy_lost")``.
        """
        return with_losses(self._dataset)

    def with_tracks(self, along: str | None = None) -> xr.Dataset:
        """The attractors of ``attractors.nc`` with `track`: the number of each along an axis.

        A track follows an attractor from value to value, while peaks and troughs at neighbouring
        values differ by at most half of the larger modulus.

        Parameters
        ----------
        along : str, optional
            As for `frequency_response`.
        """
        if "basin_share" not in self._dataset:
            raise DatasetError(missing_variable(self._dataset, "basin_share"))
        return with_tracks(self._dataset, axis_of(self._dataset, along, {}))

    def to_dataframe(self) -> Any:
        """The sweep points as a `pandas.DataFrame`, a row each, without extrema and sections.

        Columns are dimensions, then variables; those of systems have one for every coordinate or
        contact, as ``x_max[h]``. Flags are words; cells that were not requested are left out.
        """
        if "status" not in self._dataset:
            raise DatasetError(missing_variable(self._dataset, "status"))
        return to_dataframe(self._dataset)

    def to_csv(self, *columns: str, digits: int | None = None) -> str:
        """The sweep points as CSV text with units in the header, a row each.

        Lengths are in millimetres. Without `columns`, names of variables, these are the main ones;
        see `to_dataframe` for all. `digits` is the number of significant digits.
        """
        if "status" not in self._dataset:
            raise DatasetError(missing_variable(self._dataset, "status"))
        return to_csv(self._dataset, columns or None, digits)

    def frequency_response(
        self,
        variable: str = "amplitude",
        *,
        along: str | None = None,
        ax: "Axes | None" = None,
        **wanted: Any,
    ) -> "Axes":
        """A number of every response over frequency: a curve per representation and initial state.

        Curves are broken at jumps.

        Parameters
        ----------
        variable : str
            As ``"amplitude"``, ``"force_max"``, ``"contact_share"`` or, of systems,
            ``"contact_x_max"``, the peak of the relative displacement at a contact.
        along : str, optional
            Numeric dimension of the horizontal axis; None: omega, or where there is none, as of
            systems that nothing forces, the only number that is swept.
        ax : Axes, optional
            Drawn into; new ones if None.
        **wanted
            Selection by coordinate; one stiffness, one gap and one value of every other parameter
            must be left, of systems one `coordinate` or `contact`.
        """
        along = axis_of(self._dataset, along, wanted)
        names = [variable, *({"response_class"} & set(self._dataset))]
        shown = scene_along(self._dataset, along, dict.fromkeys(names, CURVES), wanted)
        kinds = shown.get("response_class")
        axes = axes_of(ax)
        marks.put(axes, drawing.curves(shown[variable], along, kinds), drawing.key_of_marks(shown))
        if kinds is not None:
            marks.put(axes, backdrop.unresolved(shown, along))
        axes.set_ylabel(axis_label(shown[variable], WORDS.get(variable, "")))
        if not (shown[variable] < 0.0).any():
            axes.set_ylim(bottom=0)
        return finished(axes, shown, along)

    bifurcation = _figure(dynamics.bifurcation)
    lyapunov = _figure(dynamics.lyapunov)
    basin_shares = _figure(dynamics.basin_shares)
    poincare = _figure(dynamics.poincare)
    waterfall = _figure(dynamics.waterfall)
    impacts = _figure(contacts.impacts)
    contact_map = _figure(contacts.contact_map)
    force_loop = _figure(force_loop)
    risk = _figure(risk_figures.risk)
    quantiles = _figure(risk_figures.quantiles)
    tornado = _figure(risk_figures.tornado)

    def special_points(self) -> Any:
        """The special points of branches as a `pandas.DataFrame`, a row each.

        The index is the number that `gapsweep.special_curve` takes as `point`. Columns are branch,
        step, kind, symbol, the parameter, the peak (of systems ``x_max[h]``), period_multiple, the
        Floquet multiplier nearest to the unit circle, and the coordinates of a study.
        """
        return of_branches.special_table(self._dataset)

    def branches(
        self,
        y: str | None = None,
        *,
        along: str | None = None,
        ax: "Axes | None" = None,
        **wanted: Any,
    ) -> "Axes":
        """Branches of periodic orbits: stable parts solid, unstable ones dashed.

        Each branch has its colour, or each representation where there are several. Special points
        are marked: LP fold, PD period doubling, NS Neimark–Sacker, BP branch point, SB
        symmetry breaking, GR graze, BLP border fold, BPD border flip, H Hopf, CP cusp; their
        symbols stand where there is room.

        Parameters
        ----------
        y : str
            Variable of the vertical axis, as ``"x_max"``, ``"amplitude"``, ``"period"`` or
            ``"frequency"``; None: ``"x_max"``, of special curves the second parameter.
        along : str, optional
            Variable of the horizontal axis; None: the parameter that the branches are continued
            along, and of free motions ``"frequency"`` (a backbone).
        ax : Axes, optional
            Drawn into; new ones if None.
        **wanted
            Selection by coordinate; of systems one `coordinate` must be left.
        """
        along = along or of_branches.default_axis(self._dataset)
        y = y or str(self._dataset.attrs.get("second", "x_max"))
        shown = of_branches.shown(self._dataset, [along, y], wanted)
        axes = axes_of(ax)
        marks.put(axes, of_branches.orbits(shown, along, [y]))
        for name, which in ((along, "x"), (y, "y")):
            axes.set(**{f"{which}label": of_branches.label(shown[name])})
            if of_branches.is_log(shown[name]):
                axes.set(**{f"{which}scale": "log"})
        titled(axes, shown)
        of_branches.name_points(axes, shown, along, y)
        return axes

    def compare(
        self,
        a: str,
        b: str,
        /,
        *,
        along: str | None = None,
        ax: "Axes | None" = None,
        **wanted: Any,
    ) -> "Axes":
        """Peaks of two representations for all initial conditions, `a` behind `b`.

        Visible dots of `a` are missed by `b`; dots of `b` without `a` behind are spurious.
        Responses that are not periodic are hollow; triangles show the direction of sweeps.

        Parameters
        ----------
        a, b : str
            Labels, as ``"piecewise"`` and ``"tanh-1e4"``.
        along, ax, **wanted
            As for `frequency_response`.
        """
        needed = {"x_max": CURVES, "response_class": CURVES}
        along = axis_of(self._dataset, along, wanted)
        both = scene_along(self._dataset, along, needed, {**wanted, "representation": [a, b]})
        shown = drawing.with_setting(both, "x_max")
        axes = axes_of(ax)
        marks.put(axes, backdrop.walls(shown, along, of_peaks=True))
        for label, size in ((a, _RIM), (b, _DOT)):
            one = selected(shown, {"representation": label})
            marks.put(axes, drawing.peaks(one, size, along=along))
            marks.put(axes, [marks.key(entry=label, colour=colour(label), size=size)])
        marks.put(axes, drawing.key_of_marks(shown, "x_max"), backdrop.unresolved(shown, along))
        axes.set_ylabel(axis_label(shown["x_max"], "peak displacement"))
        return finished(axes, shown, along)

    def attractors(
        self, *, along: str | None = None, ax: "Axes | None" = None, **wanted: Any
    ) -> "Axes":
        """Attractors: peaks over frequency, stroboscopic sections, or their initial conditions.

        From ``attractors.nc``: the peak of every attractor over frequency, the dot as large as its
        basin, hollow if not periodic; at a single frequency the stroboscopic sections. From
        ``responses.nc`` at a single frequency, and from `gapsweep.basins`: the attractor that each
        initial condition leads to; ``map("attractor", x="x_0", y="v_0")`` draws many as one mesh.

        Parameters
        ----------
        along, ax, **wanted
            As for `frequency_response`.
        """
        dataset = selected(self._dataset, wanted)
        if "attractor_number" in dataset.dims:
            return _basins(dataset, ax)
        if "basin_share" not in dataset:
            if "attractor" in dataset:
                return _starts(dataset, ax)
            raise DatasetError(missing_variable(dataset, "basin_share"))
        along = axis_of(self._dataset, along, wanted)
        if dataset.sizes.get(along, 1) == 1:
            return _sections(dataset, ax)
        needed = dict.fromkeys(
            ("x_max", "basin_share", "response_class"), ("representation", "attractor")
        )
        shown = scene_along(self._dataset, along, needed, wanted)
        axes = axes_of(ax)
        marks.put(axes, backdrop.walls(shown, along, of_peaks=True))
        for label in labels_of(shown):
            marks.put(axes, drawing.attractor_peaks(shown.sel(representation=label), along))
            marks.put(axes, [marks.key(entry=label, colour=colour(label))])
        marks.put(axes, drawing.key_of_marks(shown, "x_max"))
        axes.set_ylabel(axis_label(shown["x_max"], "peak displacement"))
        return finished(axes, shown, along)

    def agreement(
        self,
        variable: str = "amplitude_error_median",
        *,
        along: str | None = None,
        ax: "Axes | None" = None,
        **wanted: Any,
    ) -> "Axes":
        """A metric of ``agreement.nc`` with its interval and uncertainty, or over frequency.

        Parameters
        ----------
        variable : str
            A summary, as ``"same_attractor_mean"``: a row per representation with its confidence
            interval, and the exact law with other settings as a dashed line. A variable over
            `along`, as ``"amplitude_error"``: a curve per representation and initial state.
        along, ax, **wanted
            As for `frequency_response`; `regime` is ``"all"`` if not given.
        """
        if variable not in self._dataset:
            raise DatasetError(missing_variable(self._dataset, variable) + _AGREEMENT)
        along = axis_of(self._dataset, along, wanted)
        if "regime" in self._dataset[variable].dims:
            wanted = {"regime": "all", **wanted}
        if along in self._dataset[variable].dims:
            return self.frequency_response(variable, along=along, ax=ax, **wanted)
        value = scene(self._dataset, {variable: ("representation",)}, wanted)[variable]
        reference = self._dataset.attrs.get("reference")
        others = value["representation"].values != reference
        if not others.any():
            raise DatasetError(
                f"{reference}: the reference of all comparisons; choose another representation"
            )
        value = value.isel(representation=others)
        interval = _numbers(self._dataset, f"{variable}_ci", ("representation", "bound"), wanted)
        of_all = {name: what for name, what in wanted.items() if name != "representation"}
        floor = _numbers(self._dataset, f"{variable}_floor", (), of_all)
        axes = axes_of(ax)
        marks.put(axes, drawing.summary(value, interval, floor))
        rows = labels_of(value.to_dataset(name=variable))
        axes.set_yticks(range(len(rows)), rows)
        axes.set_ylim(len(rows) - 0.5, -0.5)
        axes.set_xlabel(axis_label(value))
        return titled(axes, value.to_dataset(name=variable))

    def map(
        self,
        variable: str = "period_multiple",
        x: str = "omega",
        y: str | None = None,
        *,
        ax: "Axes | None" = None,
        **wanted: Any,
    ) -> "Axes":
        """A variable over two swept numbers, a cell per point: a map.

        Classes, periods and other whole numbers have a colour each and a legend, numbers a colour
        bar; what is unresolved or failed has its own colour whatever is shown, failed cells are
        hatched, too. Blank: not requested.

        Parameters
        ----------
        variable : str
            As ``"period_multiple"``, the regimes P1, P2, ..., chaotic, quasiperiodic,
            ``"response_class"``, ``"contact_share"`` or ``"amplitude"`` of ``responses.nc``,
            ``"n_attractors"`` of ``attractors.nc``, or a number of ``agreement.nc``.
        x, y : str
            Numeric dimensions; `y` is the longest other one if None. ``"x_0"`` and ``"v_0"`` for
            initial conditions that form a full grid.
        ax, **wanted
            As for `frequency_response`; of all other dimensions one value must be left. `regime`
            is ``"all"`` if not given.
        """
        if variable in self._dataset and "regime" in self._dataset[variable].dims:
            wanted = {"regime": "all", **wanted}
        picture, shown = maps.picture(self._dataset, variable, x, y, wanted)
        axes = axes_of(ax)
        maps.draw(axes, picture)
        return titled(axes, shown)

    def work_precision(self, *, ax: "Axes | None" = None, **wanted: Any) -> "Axes":
        """Cost of every method over its error, of one scenario of ``work_precision.nc``.

        Rings mark the methods that no other beats in both; ticks at the bottom the error of the
        model itself, which no tolerance reduces; crosses at the right failed runs.

        Parameters
        ----------
        ax : Axes, optional
            Drawn into; new ones if None.
        **wanted
            Selection by coordinate; one scenario must be left.
        """
        shown = scene(
            self._dataset, dict.fromkeys(drawing.WORK_PRECISION, ("method", "tolerance")), wanted
        )
        axes = axes_of(ax)
        loglog(axes)
        marks.put(axes, drawing.work_precision(shown))
        axes.set_xlabel(axis_label(shown["total_error"]))
        axes.set_ylabel(axis_label(shown["cpu_time"]))
        return titled(axes, shown)


_AGREEMENT = "; the metrics are in agreement.nc, which gs.open opens"


def _numbers(
    dataset: xr.Dataset, name: str, dims: tuple[str, ...], wanted: dict[str, Any]
) -> xr.DataArray | None:
    """A variable over exactly these dimensions; None if the dataset lacks it."""
    if name not in dataset:
        return None
    return scene(dataset, {name: dims}, wanted)[name]


def _basins(found: xr.Dataset, ax: "Axes | None") -> "Axes":
    """Draw `basins` as a map; up to 8 attractors are named by their periods and peaks."""
    peaks = found["x_max"].isel({COORDINATE: 0}, missing_dims="ignore")
    names = drawing.attractor_names(found["period_multiple"], peaks)
    if len(names) <= maps.MOST_KINDS:
        words = " ".join(name.replace(" ", "_") for name in names)
        about = {"flag_values": np.arange(len(names)), "flag_meanings": words}
        found = found.assign(attractor=found["attractor"].assign_attrs(about))
    y, x = map(str, found["attractor"].dims)
    picture, shown = maps.picture(found, "attractor", x, y, {})
    axes = axes_of(ax)
    maps.draw(axes, picture)
    return titled(axes, shown)


def _starts(dataset: xr.Dataset, ax: "Axes | None") -> "Axes":
    if COORDINATE in dataset.coords:
        raise DatasetError(
            "attractors: x_0 and v_0 of several coordinates lie in no plane; the attractors are in "
            "attractors.nc, which gs.open opens"
        )
    # As variables, so that a single initial condition gets its dimension back, too.
    dataset = dataset.reset_coords([name for name in ("x_0", "v_0") if name in dataset.coords])
    names = ("attractor", "period_multiple", "x_max", "x_0", "v_0")
    shown = scene(dataset, dict.fromkeys(names, ("initial_condition",)), {})
    axes = axes_of(ax)
    marks.put(axes, drawing.starts(shown))
    return _plane(axes, shown["x_0"], shown["v_0"], shown)


def _sections(dataset: xr.Dataset, ax: "Axes | None") -> "Axes":
    needed = {
        "section_x": ("attractor", "section_point"),
        "section_v": ("attractor", "section_point"),
        "period_multiple": ("attractor",),
        "x_max": ("attractor",),
    }
    shown = scene(dataset, needed, {})
    axes = axes_of(ax)
    marks.put(axes, drawing.sections(shown))
    return _plane(axes, shown["section_x"], shown["section_v"], shown)


def _plane(axes: "Axes", x: xr.DataArray, v: xr.DataArray, shown: xr.Dataset) -> "Axes":
    axes.set_xlabel(axis_label(x))
    axes.set_ylabel(axis_label(v))
    return titled(axes, shown)


# xarray's own register_dataset_accessor keeps the accessor in the dataset, so that both stay alive,
# and the file open, until the garbage collector comes by. netCDF4 was seen to crash after files had
# been closed that way; a property leaves no such cycle.
xr.Dataset.gapsweep = property(GapsweepAccessor)  # type: ignore[attr-defined]  # mypy: added to xarray's class
