"""Studies of surveys, one folder a question: each can be read, changed or deleted without the others.

`study.py` computes, and returns one record; `document.py` declares its `DOCUMENT`, which prints the record, writes its
files, figures and page, and shows it in notebooks; `command.py` is its command line, `COMMANDS`. The `__init__.py` of a
study that uses others names them as `NEEDS`, and the class of its record as `RECORD`.
"""
