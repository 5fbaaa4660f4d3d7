"""Detection of ground behind volume clutter: rain, snow or dust."""
