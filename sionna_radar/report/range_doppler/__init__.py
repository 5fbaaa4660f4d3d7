"""Files and figures of range-Doppler maps."""
