"""The flight: where the radar is, where it looks, and when it sends a chirp."""
