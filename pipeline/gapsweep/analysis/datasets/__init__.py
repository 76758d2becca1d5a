"""Datasets of a study: static, histories, timing, basins, branches, recommendations."""
