"""The radar: its sweep, its antenna, and the radar equation."""
