"""Readers of foreign formats: files of other programs become our numbers; `scenario.readers` finds them."""
