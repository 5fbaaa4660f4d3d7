"""Range-Doppler maps of frames of chirps, and detection in two dimensions."""
