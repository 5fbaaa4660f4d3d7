"""Text files that a user may edit: an existing one is never overwritten."""

from pathlib import Path

from sionna_radar.foundation.errors import OutputError
from sionna_radar.foundation.input_file import shown


def write_new(path: Path, text: str, remedy: str) -> None:
    """Write text into a file that does not exist yet; OutputError, ending with the remedy, if that is impossible."""
    try:
        with path.open("x", encoding="utf-8", newline="\n") as new:
            new.write(text)
    except FileExistsError as error:
        raise OutputError(f"{shown(path)} exists already; {remedy}") from error
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise OutputError(f"{shown(path)} cannot be written ({reason}); {remedy}") from error
