"""What is inside a log of a flight: the table, the figure and their files."""
