"""Recordings of other programs, described by a TOML file."""
