from .reader import read_log as read_log
