"""The page of a scenario before it is flown."""
