"""Several folders of results side by side."""
