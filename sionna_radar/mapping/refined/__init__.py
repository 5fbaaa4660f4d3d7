"""Maps that fit range profiles or echo ranges to a smooth surface."""
