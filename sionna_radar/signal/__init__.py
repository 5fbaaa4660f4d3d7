"""From paths to beat signals."""
