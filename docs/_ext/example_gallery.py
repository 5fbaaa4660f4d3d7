"""The examples as a gallery: sections, pictures that the scripts save, and committed ones where nothing is run."""

import os
import shutil
from pathlib import Path
from typing import Any

from sphinx.application import Sphinx
from sphinx.errors import ConfigError
from sphinx_gallery.scrapers import figure_rst
from written import write

# Folder, title, and the examples in their order, without `plot_` and `.py`.
SECTIONS = {
    "scripts": (
        "First scripts: the mission in Python",
        "scenario_in_python one_chirp two_engines elevation_file custom_antenna_and_scan",
    ),
    "worlds": ("Worlds, flights and antennas", "site_model point_cloud flight_log plan terrain_following antennas"),
    "radar": (
        "What the radar and its maps do",
        "floors averaging maps uncertainty navigation refined_navigation triangular second_receiver range_doppler "
        "targets warning_time double_bounce calm_water moving_ground sar altimeter altimeter_crop sigma0_per_cell",
    ),
    "weather": ("Weather", "rain weather why_radar landing vegetation radar_and_lidar fusion circular"),
    "paper": (
        "The reference paper",
        "panorama fig05_antenna fig07_environments fig08_roof_edge fig10_two_fields fig11_doppler fig12_hills "
        "fig13_edge_error fig14_buildings table3_beamwidth",
    ),
    "designs": ("Which radar do I need?", "design_lighter design_rain design_corridor"),
}
ORDER = [f"plot_{name}.py" for _, names in SECTIONS.values() for name in names.split()]
HEADER = """Examples
========

Scripts to run, read and change; each is a file in `examples/` that is run whenever the documentation is tested.
`SIONNA_RADAR_SMALL=1` in the environment makes the long ones short. What the figures of the paper show here is on one
page, :doc:`the paper and this project </checks/paper>`.
"""


class InTheirOrder:
    """Sorts the examples of a section as `SECTIONS` has them; sphinx-gallery makes one for each section."""

    def __init__(self, folder: str) -> None:
        del folder

    def __call__(self, name: str) -> int:
        """Return the place of an example."""
        return ORDER.index(name)


def setup(app: Sphinx) -> dict[str, bool]:
    """Lay out the examples before sphinx-gallery looks for them."""
    app.connect("builder-inited", lay_out, priority=100)
    app.connect("source-read", show_committed_picture)
    return {"parallel_read_safe": True, "parallel_write_safe": True}


def lay_out(app: Sphinx) -> None:
    """Copy the examples into sections: they run in their copies' folders and leave their files there."""
    if app.config.sphinx_gallery_conf["plot_gallery"] and os.environ.get("SIONNA_RADAR_GALLERY") == "small":
        os.environ["SIONNA_RADAR_SMALL"] = "1"
    examples = Path(app.srcdir).parent / "examples"
    source = Path(app.srcdir) / "generated" / "gallery_source"
    shutil.rmtree(source, ignore_errors=True)
    write(source / "GALLERY_HEADER.rst", HEADER)
    left = {path.stem.removeprefix("plot_") for path in examples.glob("plot_*.py")}
    for number, (folder, (title, names)) in enumerate(SECTIONS.items(), 1):
        section = source / f"{number}_{folder}"
        write(section / "GALLERY_HEADER.rst", f"{title}\n{'-' * len(title)}\n")
        for name in names.split():
            write(section / f"plot_{name}.py", _with_thumbnail(examples / f"plot_{name}.py", app))
            left.discard(name)
    if left:
        message = f"examples {sorted(left)} are in no section; add them to SECTIONS in {Path(__file__).name}"
        raise ConfigError(message)


def committed_picture(srcdir: Path, name: str) -> Path | None:
    """Return what the full flights of an example drew, if it is in the repository."""
    places = (srcdir.parent / "examples" / "images" / f"{name}.png", srcdir / "pictures" / f"{name}.png")
    return next((place for place in places if place.is_file()), None)


def _with_thumbnail(path: Path, app: Sphinx) -> str:
    text = path.read_text(encoding="utf-8")
    srcdir = Path(app.srcdir)
    picture = committed_picture(srcdir, path.stem.removeprefix("plot_"))
    if app.config.sphinx_gallery_conf["plot_gallery"] or picture is None:
        return text
    from_docs = os.path.relpath(picture, srcdir).replace(os.sep, "/")
    return text.rstrip("\n") + f"\n# sphinx_gallery_thumbnail_path = '{from_docs}'\n"


def show_committed_picture(app: Sphinx, docname: str, content: list[str]) -> None:
    """Put the committed picture, of the full flights, under the introduction of an example that was not run."""
    if not docname.startswith("gallery/") or app.config.sphinx_gallery_conf["plot_gallery"]:
        return
    picture = committed_picture(Path(app.srcdir), docname.rpartition("/plot_")[2])
    if picture is not None:
        path = os.path.relpath(picture, (Path(app.srcdir) / docname).parent).replace(os.sep, "/")
        before, title, after = content[0].partition(".. rst-class:: sphx-glr-example-title")
        head, line, rest = after.partition("\n.. GENERATED FROM")
        image = f"\n.. image:: {path}\n   :alt: what the example draws\n\n"
        content[0] = before + title + head + image + line + rest


def picture_scraper(block: Any, block_vars: dict[str, Any], gallery_conf: dict[str, Any]) -> str:
    """Return the RST of the pictures that a block has saved, and move them to the gallery."""
    shown = []
    for picture in sorted(Path(block_vars["src_file"]).parent.glob("*.png"), key=lambda path: path.stat().st_mtime):
        place = Path(next(block_vars["image_path_iterator"]))
        shutil.move(picture, place)
        shown.append(str(place))
    return figure_rst(shown, gallery_conf["src_dir"])
