"""The terrains, one file a source."""
