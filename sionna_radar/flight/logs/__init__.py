"""Recorded flights: one file a format, what they have in common, and whether it can be flown."""
