"""Command ``gapsweep init``, which copies example studies from ``workflows/`` of the package."""

import shutil
from pathlib import Path

import click

from gapsweep.cli.options import echo
from gapsweep.errors import StoreError

# Files of each example, and its study file.
STUDIES = {
    "quick": ("quick.toml", "quick.toml"),
    "two-masses": ("two_masses.toml", "two_masses.toml"),
    "paper": ("paper", "paper/study.toml"),
}


@click.command()
@click.argument("name", type=click.Choice(tuple(STUDIES)), default="quick")
def init(name: str) -> None:
    """Write an example study into the current folder.

    quick (default): six contact laws at 30 frequencies, computed in seconds. two-masses: two
    coordinates and a one-sided stop. paper: the folder of the paper's study with its claims and
    figures, computed in minutes.

    \b
    Examples:
      gapsweep init quick
      gapsweep init paper
    """
    carried, study = STUDIES[name]
    _copy(_carried(carried), Path(carried))
    echo(f"written: {carried}")
    echo(f"next:    gapsweep plan {study}   # show what a run would compute")
    echo(f"         gapsweep run {study}    # compute the points, datasets and the report")


def _carried(name: str) -> Path:
    """Path of an example study: in the installed package, or else in the repository."""
    package = Path(__file__).parents[1]
    installed = package / "workflows" / name
    return installed if installed.exists() else package.parents[1] / "workflows" / name


def _copy(source: Path, target: Path) -> None:
    try:
        if source.is_dir():
            shutil.copytree(source, target, ignore=shutil.ignore_patterns("__pycache__"))
        else:
            with target.open("xb") as file:
                file.write(source.read_bytes())
    except FileExistsError:
        raise StoreError(
            f"{target}: exists already; move it, or change to another folder"
        ) from None
    except (OSError, shutil.Error) as error:
        reason = error.strerror if isinstance(error, OSError) and error.strerror else error
        raise StoreError(
            f"{target}: cannot be written: {reason}; change to another folder"
        ) from None
