"""The gamma engine: the constant-gamma facet model of the reference paper."""
