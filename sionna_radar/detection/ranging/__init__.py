"""Range estimators, one file each."""
