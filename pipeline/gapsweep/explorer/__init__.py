"""`gapsweep explore` and `gapsweep.explore`: a page that computes while its sliders move.

Not named `explore`, since that is the function: an imported module would take its place.
"""
