from .reader import read_pattern as read_pattern
