"""Landing places as files, tables and page."""

import json
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from pyproj import CRS

from sionna_radar.execution.workers import versions
from sionna_radar.foundation.raster_file import write_pixels
from sionna_radar.report.coordinates import LOCAL_FRAME, MAP_FRAME
from sionna_radar.report.page.markup import document
from sionna_radar.report.page.scene_data import MAX_MAP_CELLS, Pack, packed_map, thinned
from sionna_radar.report.page.sections import colour_scales, frame_of_page
from sionna_radar.report.study_document import Column, Columns, StudyDocument
from sionna_radar.report.terminal import number, with_spread
from sionna_radar.studies.landing.study import STATED, Landing, Site

FORMS = {"slope": (".1f", "deg"), "roughness": (".2f", "m"), "clearance": ("+.2f", "m")}
# From unfit to fit.
SCALE = [[0.0, "#a50026"], [0.5, "#ffffbf"], [1.0, "#006837"]]


def _reason(name: str, site: Site) -> str:
    (form, unit), reason = FORMS[name], site.criteria[name]
    return f"{with_spread(reason['value'], reason['sigma'], form)} {unit}, {reason['probability']:.1%}"


SITES = Columns[Site](
    [
        Column(key="east_m", heading="east", form=".1f", unit=" m"),
        Column(key="north_m", heading="north", form=".1f", unit=" m"),
        Column(key="height_m", heading="height", form=".2f", unit=" m"),
        Column(key="probability", heading="fit", form=".1%"),
        *(Column[Site](heading=name, text=partial(_reason, name)) for name in FORMS),
    ]
)
BINS = Columns[dict[str, float]](
    [
        Column(key="low", heading="stated from", form=".0%"),
        Column(key="high", heading="to", form=".0%"),
        Column(key="places", heading="places", form=",.0f"),
        Column(key="stated", heading="mean stated", form=".1%"),
        Column(key="fit", heading="fit", form=".1%"),
    ]
)


def landing_numbers(landing: Landing) -> dict[str, Any]:
    """Return the numbers of `landing.json`."""
    ground, probability = landing.ground, landing.probability
    return {
        "survey": ground.name,
        "crs": CRS.from_wkt(ground.crs_wkt).name if ground.crs_wkt else "local",
        "limits": landing.limits,
        "draws": landing.draws,
        "seed": landing.seed,
        "correlation_length_m": ground.correlation.length_m,
        "cell_m": ground.dem.grid.spacing_m,
        "obstacles": None if ground.obstacles is None else len(ground.obstacles.top_m),
        "places": int(probability.filled.sum()),
        "unknown": landing.unknown,
        "stated_fit_m2": float((probability.height_m >= STATED).sum() * probability.grid.spacing_m**2),
        "sites": landing.sites,
        "check": landing.check,
        "versions": versions(),
    }


def sites_geojson(landing: Landing) -> str:
    """Return the sites as GeoJSON in map coordinates; `crs` names them, as in GeoJSON of 2008."""
    features = [
        {
            "type": "Feature",
            "geometry": {"type": "Point", "coordinates": [site.east_m, site.north_m, site.height_m]},
            "properties": {"probability": site.probability}
            | {f"{name}_{key}": value for name, reason in site.criteria.items() for key, value in reason.items()},
        }
        for site in landing.sites
    ]
    code = CRS.from_wkt(landing.ground.crs_wkt).to_2d().to_authority() if landing.ground.crs_wkt else None
    name = {"crs": {"type": "name", "properties": {"name": f"urn:ogc:def:crs:{code[0]}::{code[1]}"}}} if code else {}
    return json.dumps({"type": "FeatureCollection", **name, "features": features}, indent=1, allow_nan=False) + "\n"


def write_probability(landing: Landing, folder: Path) -> None:
    """Write `fit_probability.tif`."""
    pixels = landing.probability.height_m[::-1].astype(np.float32)
    crs, transform = landing.ground.crs_wkt or None, landing.probability.grid.transform
    description = "probability that a place with its middle here is fit to land on"
    write_pixels(folder / "fit_probability.tif", pixels, transform, crs, description, "1", {})


def sentences(landing: Landing) -> list[str]:
    """Return the limits, what is not known, and the check against the truth."""
    limits, check, obstacles = landing.limits, landing.check, landing.ground.obstacles
    texts = [
        f"fit: {limits.footprint_m:g} m, slope to {limits.slope_deg:g} deg, roughness to {limits.roughness_m:g} m, "
        f"nothing above {limits.obstacle_m:g} m within {limits.clearance_m:g} m",
        f"unknown: {landing.unknown:.1%} of the places; whatever is smaller than a cell of "
        f"{landing.ground.dem.grid.spacing_m:g} m; obstacles reported: "
        + ("unknown" if obstacles is None else str(len(obstacles.top_m))),
    ]
    if check is not None:
        stated = f"of {check.stated:,} places stated fit at {STATED:.0%}, {number(check.precision, '.1%')} are"
        found = f"of {check.fit:,} that are fit, {number(check.recall, '.1%')} are stated so"
        stated = stated if check.stated else f"no place is stated fit at {STATED:.0%}"
        texts.append(f"truth: {stated}; {found if check.fit else 'none is fit'}")
    return texts


def landing_page(landing: Landing) -> str:
    """Return the page as HTML."""
    ground, grid, pack = landing.ground, landing.probability.grid, Pack()
    thin = thinned(grid, MAX_MAP_CELLS)
    frame = MAP_FRAME if ground.crs_wkt else LOCAL_FRAME
    look = {"low": 0.0, "high": 1.0, "scale": "fit", "unit": "Probability", "hover": "probability"}
    cells = packed_map(pack, thin.cells, thin.of(landing.probability.height_m))
    numbers = {
        "frame": frame_of_page(frame),
        "scales": colour_scales() | {"fit": SCALE},
        "map": {"name": "Probability that a place is fit", **look, **cells},
        "sites": [[site.east_m, site.north_m] for site in landing.sites],
    }
    return document(
        "landing.html",
        pack.text(numbers),
        ("maps.js", "landing.js"),
        package=__package__,
        title=f"Where to land: {ground.name}",
        sentences=sentences(landing),
        head=["Site", *SITES.heads],
        rows=[[str(rank), *row] for rank, row in enumerate(SITES.cells(landing.sites, "sites."), start=1)],
        bins_head=BINS.heads,
        bins=BINS.cells(landing.check.bins, "check.bins.") if landing.check else [],
    )


DOCUMENT = StudyDocument[Landing](
    marker="landing.json",
    suffix="_landing",
    numbers=landing_numbers,
    tables=lambda landing: [
        SITES.table("Landing sites: value and standard deviation of each criterion, its probability", landing.sites),
        *([BINS.table("Stated probability against the truth", landing.check.bins)] if landing.check else []),
    ],
    lines=sentences,
    texts={"sites.geojson": sites_geojson},
    files=[write_probability],
    page=landing_page,
)
