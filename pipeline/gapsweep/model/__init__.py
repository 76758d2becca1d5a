"""Models to simulate: oscillators, systems, gaps and contact laws."""
