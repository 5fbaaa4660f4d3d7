"""Files and figures of a link budget."""
