"""Storage of results: the point cache and NetCDF files."""
