"""Fit a model to measured sweeps; choose a parameter so that demands hold."""
