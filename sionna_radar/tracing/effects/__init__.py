"""Effects added to an engine's paths: mirrors, point targets, and the weather."""
