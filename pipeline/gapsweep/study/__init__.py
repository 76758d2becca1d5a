"""Studies: study files, sweep points, content keys and the dataset schema."""
