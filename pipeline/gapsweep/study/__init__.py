"""Studies: study files, sweep points, keys and the dataset schema."""
