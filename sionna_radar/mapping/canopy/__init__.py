"""Two surfaces: the ground under plants, and their top."""
