"""Detection of ground through a volume of rain, snow or dust."""
