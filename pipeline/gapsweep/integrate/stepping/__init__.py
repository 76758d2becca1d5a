"""Many points at once in SIMD lanes: the stepping loop of both methods, and what it records."""
