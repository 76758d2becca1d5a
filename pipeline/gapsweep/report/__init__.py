"""Figures and the HTML report, from NetCDF files only."""
