"""Files and figures of a cross-check."""
