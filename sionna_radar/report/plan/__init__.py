"""Files and tables of a flight plan."""
