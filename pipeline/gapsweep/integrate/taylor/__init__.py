"""Steps by Taylor series: the exact law, and tanh, with contacts located inside the step."""
