"""The file of measured speed ratios, which a later run compares with."""
