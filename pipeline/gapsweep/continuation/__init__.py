"""Branches of periodic orbits: continuation, special points, curves of them."""
