"""From beat signals to echoes with a range."""
