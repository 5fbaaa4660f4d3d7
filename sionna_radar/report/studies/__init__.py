"""Files, figures and tables of each study."""
