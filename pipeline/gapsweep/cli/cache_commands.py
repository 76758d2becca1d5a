"""Commands on the cache itself."""

import json
from pathlib import Path
from typing import TYPE_CHECKING

import click

from gapsweep.cli import options
from gapsweep.cli.options import echo
from gapsweep.errors import StoreError

if TYPE_CHECKING:
    from gapsweep.store.cache import Cache


@click.group("cache")
def cache_commands() -> None:
    """Inspect, verify and clean the cache.

    \b
    Examples:
      gapsweep cache info
      gapsweep cache verify
    """


def _existing(cache: Path | None, *, read_only: bool = True) -> "Cache":
    from gapsweep.run_folder import cache_path
    from gapsweep.store.cache import Cache

    path = cache_path(cache)
    if not path.exists():
        raise StoreError(f"{path}: no such folder; 'gapsweep run' creates it")
    return Cache(path, read_only=read_only)


@cache_commands.command()
@options.cache
@options.as_json
def info(cache: Path | None, as_json: bool) -> None:
    """Show the number of points by version and status.

    \b
    Example:
      gapsweep cache info --json
    """
    from gapsweep.store import maintenance
    from gapsweep.user_code.package_digest import numerics_fingerprint

    with _existing(cache) as store:
        found = maintenance.info(store, numerics_fingerprint())
    if as_json:
        echo(json.dumps(found))
        return
    size = f"{found['bytes'] / 1e6:.1f} MB in {found['segments']} segments"
    echo(f"{found['folder']}: format {found['format']}, {size}")
    echo(
        f"{found['points']} points, {found['current']} of this version of the code, "
        f"{found['of_other_code']} of other versions"
    )
    for label, count in found["status"].items():
        echo(f"{count:>10}  {label}")


@cache_commands.command()
@options.cache
def verify(cache: Path | None) -> int:
    """Check every point against its checksum and its key.

    \b
    Examples:
      gapsweep cache verify
    """
    from gapsweep.console import busy
    from gapsweep.store import maintenance

    with busy("checking all points"), _existing(cache) as store:
        verdict = maintenance.verify(store)
    echo(f"{verdict.n_points} intact points, {len(verdict.damaged)} damaged segments")
    return 0 if verdict.is_sound else 1


@cache_commands.command()
@options.cache
@click.option("--apply", is_flag=True, help="Remove; without it, only count what would be removed.")
def gc(cache: Path | None, apply: bool) -> None:
    """Remove damaged points and points of other versions.

    Small segment files are merged.

    \b
    Examples:
      gapsweep cache gc
      gapsweep cache gc --apply
    """
    from gapsweep.store import maintenance
    from gapsweep.user_code.package_digest import numerics_fingerprint

    with _existing(cache, read_only=not apply) as store:
        n_points, n_damaged = maintenance.clean(store, numerics_fingerprint(), apply=apply)
    verb = "removed:" if apply else "to be removed by 'gapsweep cache gc --apply':"
    echo(f"{verb} {n_points} points, damage in {n_damaged} segments")
