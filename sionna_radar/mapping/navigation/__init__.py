"""Errors of navigation and instrument that echoes tell of, with the ground or without it."""
