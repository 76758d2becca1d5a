"""Computation of a study on a Dask cluster: plan, tasks, workers, and export of datasets."""
