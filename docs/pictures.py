"""The pictures of the README and the pages, and the outputs of the notebooks.

python -m docs.pictures [data/runs/work-precision data/runs/two-masses data/runs/stability]
"""

import re
import shutil
import sys
from contextlib import chdir
from pathlib import Path
from tempfile import TemporaryDirectory

import matplotlib
import nbclient
import nbformat
import numpy as np
from matplotlib import pyplot
from matplotlib.figure import Figure
from workflows.paper.paper_figures import start_scan
from workflows.paper.refined import starts

import gapsweep as gs
from gapsweep.report.bench_figures import atlas
from gapsweep.report.branch_lines import lines, shown
from gapsweep.report.style import MATPLOTLIB, colour

IMAGES = Path(__file__).parent / "images"
METHODS = [
    "piecewise",
    "piecewise@restart",
    "piecewise@scipy",
    "piecewise-noevents",
    "tanh-1e4",
    "tanh-1e6",
    "poly-21",
]
SCENES = ["soft-sym-9", "soft-asym-9", "hard-sym-9", "hard-asym-9"]


def pages() -> None:
    """Pictures that the code of gallery pages and tutorials draws."""
    matplotlib.use("Agg")
    for page in sorted(Path(__file__).parent.glob("*/*.md")):
        blocks = re.findall(r"^```python\n(.*?)^```$", page.read_text(), re.DOTALL | re.MULTILINE)
        drawn = [path for path in page.parent.glob("*.png") if f"({path.name})" in page.read_text()]
        if not blocks or not drawn:
            continue
        with TemporaryDirectory() as folder, chdir(folder):
            for data in page.parent.glob("*.csv"):
                shutil.copy(data, folder)
            exec("".join(blocks), {})
            for picture in drawn:
                shutil.copy(picture.name, picture)
        pyplot.close("all")


def notebooks() -> None:
    """Run every notebook in an empty folder and store its outputs."""
    for path in sorted(Path(__file__).parent.glob("notebooks/*.ipynb")):
        notebook = nbformat.read(path, as_version=4)
        with TemporaryDirectory() as folder:
            where = {"metadata": {"path": folder}}
            nbclient.NotebookClient(notebook, timeout=300, resources=where).execute()
        for cell in notebook.cells:
            cell.metadata.pop("execution", None)  # times
        nbformat.write(notebook, path)


def hero() -> None:
    """Steady states of a loose joint over frequency, and basins where several coexist."""
    joint = gs.Oscillator(mass=3.0, omega_n=5.0, zeta=0.03, alpha=7e8, forcing=4.0)
    gap = gs.Gap(0.4e-3, 0.4e-3)
    laws = {
        "exact contact": ("piecewise", gs.Piecewise(1.4e4, gap)),
        "tanh, ε = 5000 /m": ("tanh-5e3", gs.Tanh(1.4e4, gap, 5e3)),
    }
    frequency = np.linspace(3.0, 16.0, 261)
    x, v = np.meshgrid(np.linspace(-3e-3, 3e-3, 4), np.linspace(-0.2, 0.2, 3))
    figure = Figure(figsize=(10.0, 3.6), layout="constrained")
    left, right = figure.subplots(1, 2, width_ratios=(2, 1))
    for (name, (label, law)), size in zip(laws.items(), (5.0, 2.0), strict=True):
        steady = gs.respond(joint, law, frequency[:, None], x.ravel(), v.ravel())
        left.plot(frequency, 1e3 * steady.x_max, ".", color=colour(label), markersize=size)
        left.plot([], [], ".", color=colour(label), markersize=8, label=name)
    exact = laws["exact contact"][1]
    orbits = shown(gs.branches(joint, exact, between=(3.0, 16.0)), ["omega", "x_max"], {})
    for _, is_stable, part in lines(orbits, "omega", "x_max"):
        if not is_stable:
            left.plot(*part.T, "k--", linewidth=0.9)
    left.plot([], [], "k--", linewidth=0.9, label="exact contact, unstable")
    left.set(xlabel="forcing frequency [Hz]", ylabel="peak displacement [mm]")
    left.legend(loc="upper left", frameon=False)
    edges = np.linspace(-4e-3, 4e-3, 240), np.linspace(-0.3, 0.3, 240)
    basins = gs.basins(joint, exact, 12.0, x=edges[0], v=edges[1])
    basins.gapsweep.attractors(ax=right)
    below = {"loc": "upper left", "bbox_to_anchor": (0.0, -0.2), "frameon": False, "fontsize": 8}
    right.legend(handles=right.get_legend().legend_handles, **below)
    left.set_title("steady states from 12 initial conditions", loc="left", fontsize=10)
    right.set_title("basins of the exact law at 12 Hz", loc="left", fontsize=10)
    figure.savefig(IMAGES / "hero.png", dpi=110)


def start() -> None:
    """Initial conditions from which the exact law has the paper's band of period 3."""
    study = gs.Study.load(IMAGES.parents[1] / "workflows" / "paper" / "study.toml")
    start_scan(starts(study)).savefig(IMAGES / "start.png", dpi=110)


def work_precision(folder: Path) -> None:
    """Cost over error in four scenes of the benchmark."""
    figure = Figure(figsize=(9.5, 7.0))
    with gs.open(folder / "work_precision.nc") as ds:
        for axes, scene in zip(figure.subplots(2, 2).flat, SCENES, strict=True):
            ds.gapsweep.work_precision(scene=scene, method=METHODS, ax=axes)
            axes.set_title(scene, fontsize=9, loc="left")
    figure.savefig(IMAGES / "work_precision.png", dpi=110)


def failures(folder: Path) -> None:
    """Outcomes of every method on every hard scenario, at tight tolerances."""
    with gs.open(folder / "stability.nc") as ds:
        atlas(ds, tight=True).savefig(IMAGES / "failures.png", dpi=100)


def two_masses(folder: Path) -> None:
    """Steady extrema of both masses, swept upwards."""
    figure = Figure(figsize=(9.5, 5.6))
    with gs.open(folder / "responses.nc") as ds:
        for axes, name in zip(figure.subplots(2, sharex=True).flat, ("x_1", "x_2"), strict=True):
            ds.gapsweep.bifurcation(
                representation="piecewise", coordinate=name, initial_condition="sweep_up", ax=axes
            )
            axes.set_title("", loc="left")
            axes.set_ylabel(name)
    figure.axes[0].set_xlabel("")
    figure.savefig(IMAGES / "two_masses.png", dpi=110)


if __name__ == "__main__":
    with matplotlib.rc_context(MATPLOTLIB):
        drawn = work_precision, two_masses, failures
        for draw, folder in zip(drawn, sys.argv[1:], strict=False):
            draw(Path(folder).absolute())
        hero()
        start()
    pages()
    notebooks()
