"""Files, figures and tables of a sweep."""
