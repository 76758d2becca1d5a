"""Execution of a study on a Dask cluster."""
