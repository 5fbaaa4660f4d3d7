"""The backscatter models available to scenarios, one file per family."""
