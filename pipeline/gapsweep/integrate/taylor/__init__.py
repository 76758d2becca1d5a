"""The exact law: Taylor series with contacts located inside the step, points in SIMD lanes."""
