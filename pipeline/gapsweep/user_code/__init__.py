"""User code of a study as a snapshot of bytes, and digests of gapsweep's source."""
