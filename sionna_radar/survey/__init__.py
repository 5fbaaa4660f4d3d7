"""A survey from preparation to result."""
