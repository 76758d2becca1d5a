"""All other laws: explicit Runge–Kutta pairs with dense output, points in SIMD lanes."""
