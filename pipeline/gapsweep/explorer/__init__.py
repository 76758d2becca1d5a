"""`gapsweep explore` and `gapsweep.explore`: a page that computes while its sliders move.

The package is not named `explore`: its import would replace the function of that name.
"""
