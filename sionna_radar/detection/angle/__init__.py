"""Angle of arrival inside the beam: interferometry, monopulse, MUSIC, and MIMO arrays."""
