"""What is asked: study files, sweep points, keys and the dataset schema."""
