"""What people look at: figures and the HTML report, from NetCDF files alone."""
