"""Angles of arrival inside the beam, from receivers beside the first."""
