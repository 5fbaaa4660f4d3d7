"""Files, figures and tables of processed recordings."""
