"""Rows of lanes: the ground that the steppers and the stepping loop share."""
