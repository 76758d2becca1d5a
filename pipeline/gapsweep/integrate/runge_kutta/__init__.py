"""Explicit Runge–Kutta pairs with dense output in SIMD lanes, for laws without Taylor series."""
