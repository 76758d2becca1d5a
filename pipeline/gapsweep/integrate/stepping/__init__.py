"""Stepping loop for many points at once in SIMD lanes, for any method, and its records."""
