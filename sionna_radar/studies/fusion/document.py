"""Fused DEMs as files, tables and page."""

from functools import partial
from pathlib import Path
from typing import Any

from pyproj import CRS

from sionna_radar.execution.workers import versions
from sionna_radar.foundation.raster import Raster
from sionna_radar.report.coordinates import LOCAL_FRAME, MAP_FRAME
from sionna_radar.report.page.markup import document
from sionna_radar.report.page.scene_data import MAX_MAP_CELLS, Pack, packed_map, thinned
from sionna_radar.report.page.sections import colour_scales, frame_of_page, span_of
from sionna_radar.report.study_document import Column, Columns, StudyDocument
from sionna_radar.report.terminal import NONE, with_spread
from sionna_radar.studies.fusion.consistency import FALSE_ALARM, NEIGHBOURHOOD_CELLS, SIGMA_OF, GriddedSource, Pair
from sionna_radar.studies.fusion.results import MADE_OF, RECORD
from sionna_radar.studies.fusion.study import Fusion

MAPS = 4
DESCRIPTIONS = {
    "dem": "fused DEM height",
    "dem_sigma": "standard deviation of the fused DEM height: cells and navigation as the sources state them, without "
    "what is common to all of them",
    "source": "sources of each cell: sum of 2^n over their numbers",
    "contradictions": "span of the heights of all sources where two contradict each other",
}


def _parameter(pair: Pair, name: str) -> str:
    """Return a parameter of a shift in m, or mm/m, with its standard deviation."""
    value = None if pair.shift is None else getattr(pair.shift, name)
    if pair.shift is None or value is None:
        return NONE
    factor, form = (1.0, ".3f") if name.endswith("_m") else (1e3, ".1f")
    return with_spread(factor * value, factor * getattr(pair.shift, SIGMA_OF[name]), form)


HEADINGS = {
    "up_m": "offset, m",
    "tilt_east": "tilt east, mm/m",
    "tilt_north": "north, mm/m",
    "east_m": "shift east, m",
    "north_m": "north, m",
}
SOURCES = Columns[GriddedSource](
    [
        Column(key="name", heading="source"),
        Column(key="kind", heading="kind"),
        Column(key="cells", heading="cells", form=",.0f"),
        Column(key="median_sigma_m", heading="sigma", form=".3f", unit=" m"),
        Column(key="moved"),
        Column(key=MADE_OF),
    ]
)
PAIRS = Columns[Pair](
    [
        Column(heading="first minus second", value=lambda pair: f"{pair.first} - {pair.second}"),
        Column(key="first"),
        Column(key="second"),
        Column(key="cells", heading="cells", form=",.0f"),
        *(Column[Pair](heading=text, text=partial(_parameter, name=name)) for name, text in HEADINGS.items()),
        Column(key="shift"),
        Column(key="chi2", heading="chi2", form=".2f"),
        Column(key="p", heading="p", form=".3f"),
        Column(key="scatter"),
        Column(key="contradicting"),
        Column(key="findings", heading="finding", value=lambda pair: "; ".join(pair.findings) or "agree"),
    ]
)


def fusion_numbers(fusion: Fusion) -> dict[str, Any]:
    """Return the numbers of `fuse.json`."""
    place = fusion.dem.grid.georeference
    return {
        "crs": CRS.from_wkt(place.crs_wkt).name if place else "local",
        "cell_m": fusion.dem.grid.spacing_m,
        "cells": int(fusion.dem.filled.sum()),
        "left_empty": fusion.left_empty,
        "legend": {str(value): text for value, text in fusion.legend.items()},
        "cells_by_source": {
            text: int((fusion.source.height_m == value).sum()) for value, text in fusion.legend.items()
        },
        "false_alarm_rate": FALSE_ALARM,
        "neighbourhood_cells": NEIGHBOURHOOD_CELLS,
        "sources": SOURCES.numbers(fusion.sources),
        "pairs": PAIRS.numbers(fusion.pairs),
        "suspect": fusion.suspect,
        "aligned_to": fusion.aligned_to,
        "terrain_prior": fusion.covariance,
        "warnings": fusion.warnings,
        "versions": versions(),
    }


def _rasters(fusion: Fusion) -> dict[str, Raster]:
    return {
        "dem": fusion.dem,
        "dem_sigma": fusion.sigma,
        "source": fusion.source,
        "contradictions": fusion.contradictions,
    }


def write_rasters(fusion: Fusion, folder: Path) -> None:
    """Write the four rasters; the legend of `source.tif` is in its metadata."""
    for name, raster in _rasters(fusion).items():
        legend = {f"SOURCE_{value}": text for value, text in fusion.legend.items()} if name == "source" else {}
        raster.to_geotiff(folder / f"{name}.tif", DESCRIPTIONS[name], legend)


def sentences(fusion: Fusion) -> list[str]:
    """Return the number of cells made of each set of sources, and the meaning of the tests."""
    made = (f"{(fusion.source.height_m == value).sum():,} of {text}" for value, text in fusion.legend.items())
    return [
        f"cells: {'; '.join(made)}; left empty by contradictions: {fusion.left_empty:,}",
        "shifts: with their standard deviations; chi2: mean squared difference over its variance, 1 as stated; p: of "
        f"that or more; {FALSE_ALARM:.0%} of consistent fusions have any finding",
    ]


def fusion_page(fusion: Fusion) -> str:
    """Return the page as HTML."""
    pack, place = Pack(), fusion.dem.grid.georeference
    thin = thinned(fusion.dem.grid, MAX_MAP_CELLS // MAPS)
    frame = MAP_FRAME if place else LOCAL_FRAME
    maps = []
    for name, raster in _rasters(fusion).items():
        low, high = span_of(raster.height_m)
        look = {"low": low, "high": high, "scale": "height", "unit": raster.unit, "hover": raster.quantity}
        if name == "source":
            look |= {"low": 0.0, "high": max(fusion.legend, default=1), "scale": "level", "hover": "sources"}
        cells = packed_map(pack, thin.cells, thin.of(raster.height_m))
        maps.append({"name": DESCRIPTIONS[name].split(":")[0], **look, **cells})
    numbers = {"frame": frame_of_page(frame), "scales": colour_scales(), "maps": maps}
    return document(
        "fusion.html",
        pack.text(numbers),
        ("maps.js", "fusion.js"),
        package=__package__,
        title=" + ".join(source.name for source in fusion.sources),
        warnings=fusion.warnings,
        sentences=sentences(fusion),
        maps=len(maps),
        legend=[[str(value), text] for value, text in fusion.legend.items()],
        source_head=SOURCES.heads,
        sources=SOURCES.cells(fusion.sources, "sources."),
        pair_head=PAIRS.heads,
        pairs=PAIRS.cells(fusion.pairs, "pairs."),
    )


DOCUMENT = StudyDocument[Fusion](
    marker=RECORD,
    suffix="_fused",
    numbers=fusion_numbers,
    tables=lambda fusion: [
        SOURCES.table("Sources", fusion.sources),
        PAIRS.table("Consistency of each two sources", fusion.pairs),
    ],
    lines=sentences,
    files=[write_rasters],
    page=fusion_page,
)
