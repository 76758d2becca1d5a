"""Datasets of a study: static, histories, timing, basins, branches, risk, recommendations."""
