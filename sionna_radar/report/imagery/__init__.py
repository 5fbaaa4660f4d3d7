"""Files, figures and tables of radar images."""
