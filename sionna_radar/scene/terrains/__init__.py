"""The terrains, one file per source."""
