"""The tracing engines, one file each."""
