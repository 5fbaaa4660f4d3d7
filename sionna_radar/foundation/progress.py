"""Progress of long computations."""

from collections.abc import Callable

# Called at the start of a stage and after each of its steps with the stage's name, the steps done, and the steps in
# all; these are 0 where nobody knows them.
Progress = Callable[[str, int, int], None]


def silent(stage: str, done: int, total: int) -> None:
    """Tell nobody."""
