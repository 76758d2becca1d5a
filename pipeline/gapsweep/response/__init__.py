"""Steady responses of sweep points: search, classification and stability."""
