"""What a sweep point answers: its steady response."""
