"""Studies of surveys, one folder a question: each can be read, changed or deleted without the others.

`study.py` computes, and returns one record; `document.py` makes its files, tables, figures and page; `command.py` is
its command line, `COMMANDS`. The `__init__.py` of a study that uses others names them as `NEEDS`, and a record that
notebooks show as `RECORD`: `views` of its document returns the tables and figures.
"""
