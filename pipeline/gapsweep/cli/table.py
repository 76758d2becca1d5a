"""A dataset of responses as a table."""

import json
from pathlib import Path

import click
import numpy as np
import xarray as xr

from gapsweep.errors import StoreError
from gapsweep.status import Status
from gapsweep.store.artefact import replacing
from gapsweep.study.grid import CONTACT, COORDINATE


def check_output(output: Path) -> None:
    """Refuse a file that is there, or has no folder, before anything is computed for it.

    Raises
    ------
    StoreError
    """
    if output.exists():
        raise StoreError(f"{output}: exists already; name a new file")
    if not output.parent.is_dir():
        raise StoreError(f"{output}: there is no folder {output.parent}")


def written(responses: xr.Dataset, form: str, output: Path | None) -> None:
    """Write a dataset as ``csv`` or ``json`` (one row per sweep point) or ``nc``.

    Raises
    ------
    StoreError
        If the file cannot be written.
    """
    if output is None:
        click.echo(_text(responses, form), nl=False)
        return
    with replacing(output) as temporary:
        if form == "nc":
            responses.to_netcdf(temporary, engine="netcdf4", format="NETCDF4")
        else:
            temporary.write_text(_text(responses, form), encoding="utf-8")


def _text(responses: xr.Dataset, form: str) -> str:
    """The variables that have one value per point, coordinate or contact; flags in words."""
    points = responses["status"].dims
    starts = [name for name, held in responses.coords.items() if held.ndim > 1]
    responses = responses.drop_vars(starts)
    columns: dict[str, xr.DataArray] = {}
    for name, variable in responses.data_vars.items():
        if variable.dims == points:
            columns[str(name)] = variable
        elif variable.dims[:-1] == points and variable.dims[-1] in (COORDINATE, CONTACT):
            for part in variable.transpose(variable.dims[-1], ...):
                of = part[variable.dims[-1]].item()
                columns[f"{name}[{of}]"] = part.drop_vars(variable.dims[-1])
    frame = _in_words(xr.Dataset(columns)).to_dataframe().reset_index()
    frame = frame[frame["status"] != Status.NOT_REQUESTED.label]
    if form == "csv":
        return str(frame.to_csv(index=False))
    rows = json.loads(frame.to_json(orient="records", double_precision=15))
    return "".join(json.dumps(row) + "\n" for row in rows)


def _in_words(dataset: xr.Dataset) -> xr.Dataset:
    words = {}
    for name, variable in dataset.data_vars.items():
        if "flag_meanings" in variable.attrs:
            meanings = variable.attrs["flag_meanings"].split()
            values = np.atleast_1d(variable.attrs["flag_values"]).tolist()
            known = dict(zip(values, meanings, strict=True))
            text = [known.get(value, "") for value in variable.values.ravel().tolist()]
            words[name] = (variable.dims, np.array(text, dtype=object).reshape(variable.shape))
    return dataset.assign(words)
