"""Where results live: the point cache and NetCDF files."""
