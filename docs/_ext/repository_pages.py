"""Pages that stand elsewhere in the repository are included; their links are made to lead to the built pages."""

import os
import re
from pathlib import Path

from sphinx.application import Sphinx

# A page of the repository and the page here that includes it.
PAGES = {
    "README.md": "index.md",
    "CONTRIBUTING.md": "contributing.md",
    "CHANGELOG.md": "changelog.md",
    "examples/WORLDS.md": "worlds.md",
    "examples/PRODUCTS.md": "products.md",
    "examples/PAPER.md": "checks/paper.md",
    "examples/RAIN.md": "checks/rain.md",
    "examples/WEATHER.md": "checks/weather.md",
    "examples/LIDAR.md": "checks/lidar.md",
    "examples/CIRCULAR.md": "checks/circular.md",
    "examples/ALTIMETER.md": "checks/altimeter.md",
    "examples/plugin/README.md": "plugin.md",
}
LINK = re.compile(r"(?<=\]\()([^)#\s]*)(#[^)\s]*)?(?=\))")


def setup(app: Sphinx) -> dict[str, bool]:
    """Follow what is included."""
    app.connect("include-read", relink)
    return {"parallel_read_safe": True, "parallel_write_safe": True}


def relink(app: Sphinx, relative_path: Path, parent: str, content: list[str]) -> None:
    """Change the links of an included page of the repository."""
    root = Path(app.srcdir).parent
    source = Path(os.path.normpath(Path(app.srcdir) / relative_path))
    if source.suffix == ".md" and source.is_relative_to(root) and not source.is_relative_to(app.srcdir):
        where = (Path(app.srcdir) / app.env.docname).parent  # `parent` lacks the folder
        content[0] = LINK.sub(lambda link: _target(link, source.parent, where, root), content[0])


def _target(link: re.Match[str], folder: Path, where: Path, root: Path) -> str:
    address, anchor = link[1], link[2] or ""
    if not address or "://" in address:
        return link[0]
    file = Path(os.path.normpath(folder / address))
    page = PAGES.get(file.relative_to(root).as_posix())
    if page:
        return os.path.relpath(root / "docs" / page, where).replace(os.sep, "/") + anchor
    if file.is_relative_to(root / "docs"):
        return os.path.relpath(file, where).replace(os.sep, "/") + anchor
    if file.suffix == ".py" and file.name.startswith("plot_"):
        [made] = (root / "docs" / "generated" / "gallery_source").glob(f"*/{file.name}")
        gallery = root / "docs" / "gallery" / made.parent.name / f"{made.stem}.rst"
        return os.path.relpath(gallery, where).replace(os.sep, "/")
    return os.path.relpath(file, where).replace(os.sep, "/") + anchor
