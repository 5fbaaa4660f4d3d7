"""Images from pulses: the real-aperture image of a side-looking radar, and synthetic-aperture focusing."""
