"""Files of measured and computed radiation patterns, one module a family of formats."""
