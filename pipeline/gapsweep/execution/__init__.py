"""How a study is carried out on a Dask cluster."""
