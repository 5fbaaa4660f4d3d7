"""The page of a scenario before it is flown."""

from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from sionna_radar.foundation.sequences import spread_indices
from sionna_radar.report.coordinates import Coordinates, Frame, frame_of
from sionna_radar.report.files.contents import write_text
from sionna_radar.report.files.folder import write_folder
from sionna_radar.report.files.signed_file import SignedFile
from sionna_radar.report.page.beams import Beams, cast_beams
from sionna_radar.report.page.markup import document
from sionna_radar.report.page.scene_data import (
    Pack,
    Solids,
    Surroundings,
    box_of,
    flown_rows,
    packed_track,
    solids_within,
    standing,
    surroundings,
    track_of,
)
from sionna_radar.report.page.sections import bounds_of, colour_scales, frame_of_page, span_of
from sionna_radar.report.terminal import number
from sionna_radar.scenario import to_toml
from sionna_radar.scene.raycast import RayCaster
from sionna_radar.survey.checks import BoresightHits
from sionna_radar.survey.preparation import Prepared

PULSES, FOOTPRINTS = 240, 60
MAX_CELLS = 50_000


def show_page(prepared: Prepared, name: str, coordinates: Coordinates = Coordinates.MAP) -> str:
    """Return the page of a prepared survey as HTML; raises OutputError if it would be too large, or without plotly.

    name: of the scenario, its title without a description.
    """
    frame, pack = frame_of(prepared.world.scene.georeference, coordinates), Pack()
    index = spread_indices(PULSES, len(prepared))
    beams, hits = cast_beams(prepared, index), prepared.plan.hits
    solids = solids_within(prepared.world.scene, prepared.scenario.terrain.kind, box_of(prepared))
    ground = _ground(prepared, solids)
    numbers = {
        "frame": frame_of_page(frame),
        "scales": colour_scales(),
        "chosen": len(index) // 2,
        "world": _world(prepared, pack, frame, ground, solids, beams, hits),
    }
    return document(
        "show.html",
        pack.text(numbers),
        ("world.js",),
        title=prepared.scenario.description or name,
        warnings=prepared.warnings + prepared.plan.flown.warnings,
        tiles=_tiles(prepared, beams, hits),
        solids=solids,
        pulses=len(index),
        footprints=min(FOOTPRINTS, len(index)),
        flown=flown_rows(prepared),
        scenario=to_toml(prepared.scenario),
    )


def _ground(prepared: Prepared, solids: Solids | None) -> Surroundings:
    """Return the ground below the solids; without solids the highest surface."""
    world, box = prepared.world, box_of(prepared)
    if solids is None:
        return surroundings(world.caster, world.scene, box, MAX_CELLS)
    lying = [surface for surface in world.scene.surfaces if not standing(surface, prepared.scenario.terrain.kind)]
    return surroundings(RayCaster(lying) if lying else world.caster, world.scene, box, MAX_CELLS)


def _world(
    prepared: Prepared,
    pack: Pack,
    frame: Frame,
    ground: Surroundings,
    solids: Solids | None,
    beams: Beams,
    hits: BoresightHits,
) -> dict[str, Any]:
    (low, high), up = span_of(ground.height_m), frame.origin_m[2]
    tops_m = [track_of(prepared.flight)[:, 2].max(), *([solids.vertices_m[:, 2].max()] if solids else [])]
    return {
        "shapes": [{"name": "ground", **ground.packed(pack)}],
        "paints": [{"name": "Height (m)", "scale": "height", "low": low + up, "high": high + up}],
        "solids": solids.packed(pack) if solids else None,
        "rim": pack.exact(_edge_of_dem(prepared)),
        "footprints": pack.exact(_rings(beams)) if beams.outline_m.shape[1] else None,
        "hits": pack.exact(hits.hit_m),
        "track": packed_track(pack, prepared.flight),
        "beams": beams.packed(pack),
        "bounds": bounds_of(box_of(prepared), ground.height_m, np.array(tops_m)),
    }


def _edge_of_dem(prepared: Prepared) -> Float[np.ndarray, "n 3"]:
    west, east, south, north = prepared.mapper.grid.extent_m
    corners = np.array([[west, south], [east, south], [east, north], [west, north], [west, south]])
    sides = [np.linspace(a, b, 60, endpoint=False) for a, b in pairwise(corners)]
    edge = np.concatenate([*sides, corners[:1]])
    return np.column_stack([edge, prepared.world.top_m(edge) + 0.1])


def _rings(beams: Beams) -> Float[np.ndarray, "n 3"]:
    """Return the outlines of some footprints, separated by NaN."""
    rows = np.linspace(0, len(beams.fan) - 1, min(FOOTPRINTS, len(beams.fan))).round().astype(int)
    rings = beams.outline_m[np.unique(rows)]
    above = np.array([0.0, 0.0, 0.05])
    closed = np.concatenate([rings, rings[:, :1], np.full((len(rings), 1, 3), np.nan)], axis=1)
    return (closed + above).reshape(-1, 3)


def _tiles(prepared: Prepared, beams: Beams, hits: BoresightHits) -> list[tuple[str, str, str]]:
    """Return the key figures of the page: number, name and remark."""
    hit = np.isfinite(hits.range_m)
    range_m = hits.range_m[hit]
    rings = beams.outline_m
    diagonal_m = np.linalg.norm(np.ptp(rings, axis=1), axis=-1) if rings.shape[1] else np.zeros(0)
    diagonal_m = diagonal_m[np.isfinite(diagonal_m)]
    trajectory = prepared.flight.trajectory
    start, end = trajectory.cruise_s()
    west, east, south, north = prepared.mapper.grid.extent_m
    nothing = float("nan")
    nearest, farthest = (range_m.min(), range_m.max()) if range_m.size else (nothing, nothing)
    return [
        (f"{len(prepared.flight):,}", "pulses", f"in {end - start:.1f} s of flight"),
        (
            f"{number(nearest, '.1f')} to {number(farthest, '.1f', ' m')}",
            "range to the ground",
            f"{prepared.receiver.chirp.max_range_m:.0f} m can be measured",
        ),
        (
            number(float(np.median(diagonal_m)) if diagonal_m.size else nothing, ".2g", " m"),
            "footprint",
            "diagonal of its box at half power, median",
        ),
        (f"{east - west:.0f} x {north - south:.0f} m", "area of the DEM", "dashed in the view"),
        (f"{1 - hit.mean():.1%}", "beams without ground", "of the axes"),
    ]


MARKER = "show.html"


def write_page(page: str, directory: Path) -> Path:
    """Write `show.html` into a directory, and return the file; raises OutputError as `write_folder`."""
    write_folder(directory, MARKER, lambda folder: write_text(folder / MARKER, page))
    return directory / MARKER


PAGE_FILE = SignedFile(command="show", before="<!-- ", after=" -->", at_end=True)
