"""Files, figures and tables of a survey."""
