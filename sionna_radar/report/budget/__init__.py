"""Files, figures and tables of a navigation budget."""
