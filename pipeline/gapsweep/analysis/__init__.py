"""Evaluation of results: datasets in, datasets out."""
