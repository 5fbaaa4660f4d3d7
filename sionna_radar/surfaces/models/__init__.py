"""The models of backscatter that scenarios name."""
