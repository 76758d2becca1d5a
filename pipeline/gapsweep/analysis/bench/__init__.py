"""Benchmarks: methods on scenarios, against independent references."""
