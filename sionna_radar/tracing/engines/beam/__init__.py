"""The beam engine: rays drawn anew for every pulse."""
