"""The scans, one file each."""
