"""Commands on the cache itself."""

import json
from pathlib import Path
from typing import TYPE_CHECKING

import click

from gapsweep.cli import options
from gapsweep.errors import StoreError

if TYPE_CHECKING:
    from gapsweep.store.cache import Cache


@click.group("cache")
def cache_commands() -> None:
    """Look after the cache: contents, soundness, size and copies.

    \b
    Examples:
      gapsweep cache info
      gapsweep cache verify
    """


def _existing(cache: Path | None, *, read_only: bool = True) -> "Cache":
    from gapsweep.store.cache import Cache

    return Cache(_path(cache), read_only=read_only)


def _path(cache: Path | None) -> Path:
    from gapsweep.lookup import cache_path

    path = cache_path(cache)
    if not path.exists():
        raise StoreError(f"{path}: no such file; 'gapsweep run' makes it")
    return path


@cache_commands.command()
@options.cache
@options.as_json
def info(cache: Path | None, as_json: bool) -> None:
    """Say how much is stored, of which code, and with which outcome.

    \b
    Example:
      gapsweep cache info --json
    """
    from gapsweep.store import maintenance
    from gapsweep.user_code.package_digest import numerics_fingerprint

    with _existing(cache) as store:
        found = maintenance.info(store, numerics_fingerprint())
    if as_json:
        click.echo(json.dumps(found))
        return
    click.echo(f"{found['file']}: format {found['format']}, {found['bytes'] / 1e6:.1f} MB")
    click.echo(
        f"{found['points']} points, {found['current']} of the present code, "
        f"{found['of_other_code']} of other code"
    )
    for label, count in found["status"].items():
        click.echo(f"{count:>10}  {label}")


@cache_commands.command()
@options.cache
def verify(cache: Path | None) -> int:
    """Check the file and every point against their checksums.

    \b
    Examples:
      gapsweep cache verify
    """
    from gapsweep.console import busy
    from gapsweep.store import maintenance

    with busy("reading every point"), _existing(cache) as store:
        verdict = maintenance.verify(store)
    for fault in verdict.faults:
        click.echo(f"file: {fault}", err=True)
    for key in verdict.damaged[: options.FEW]:
        click.echo(f"damaged point: {key}", err=True)
    if (n_more := len(verdict.damaged) - options.FEW) > 0:
        click.echo(f"and {n_more} more", err=True)
    click.echo(f"{verdict.n_points} points, {len(verdict.damaged)} damaged")
    if verdict.faults:
        click.echo("the next run saves the sound ones and sets the file aside", err=True)
    elif verdict.damaged:
        click.echo("the next run computes damaged points again", err=True)
    return 0 if verdict.is_sound else 1


@cache_commands.command()
@options.cache
@click.option("--apply", is_flag=True, help="Really delete.  [default: only say what would go]")
def gc(cache: Path | None, apply: bool) -> None:
    """Delete what other code has computed, and what is damaged.

    \b
    Examples:
      gapsweep cache gc
      gapsweep cache gc --apply
    """
    from gapsweep.store import maintenance
    from gapsweep.user_code.package_digest import numerics_fingerprint

    with _existing(cache, read_only=False) as store:
        rows = maintenance.removable(store, numerics_fingerprint())
        n_points = sum(slab.n_points for number, slab in store.slabs() if number in rows)
        if apply and rows:
            maintenance.remove(store, rows)
    verb = "deleted" if apply else "could be deleted; --apply does it"
    click.echo(f"{n_points} points {verb}")


@cache_commands.command()
@click.argument("file", type=click.Path(path_type=Path, dir_okay=False))
@options.cache
def export(file: Path, cache: Path | None) -> None:
    """Copy all sound results to a new cache FILE.

    \b
    Example:
      gapsweep cache export copy.sqlite
    """
    from gapsweep.store import maintenance

    n_points = maintenance.export(_path(cache), file)
    click.echo(f"{n_points} points in {file}")
