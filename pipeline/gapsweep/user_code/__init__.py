"""A study's own Python code, read once into bytes, and the digests of gapsweep's own source."""
