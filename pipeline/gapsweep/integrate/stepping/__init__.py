"""Stepping loop for many points at once in SIMD lanes, for both methods, and its records."""
