"""Attractors of responses that are all in memory."""

from gapsweep.response.attractors import Grouping


def attractors_of_scenes(responses, scene, *, unit, symmetric, counted=None):
    """Group the responses of many cases into attractors, all at once."""
    grouping = Grouping(unit)
    grouping.add(responses, scene, counted)
    return grouping.attractors(symmetric)
