"""What the results say: datasets in, datasets out."""
