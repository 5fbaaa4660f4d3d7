"""Pages made at build time; all are in `docs/generated`, which git ignores."""

from pathlib import Path


def write(path: Path, text: str) -> None:
    """Write a made page, unless it holds the same text: what has not changed is not built again."""
    if path.is_file() and path.read_text(encoding="utf-8") == text:
        return
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text, encoding="utf-8")
