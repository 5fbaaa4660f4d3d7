"""The page of a scenario before it is flown."""

from typing import Any

import numpy as np
from jaxtyping import Float

from sionna_radar.accuracy.truth import CLEAR_M
from sionna_radar.report.drawing import Coordinates, Frame, frame_of
from sionna_radar.report.files.folder import SignedFile
from sionna_radar.report.page import markup
from sionna_radar.report.page.markup import document
from sionna_radar.report.page.scene_data import (
    Beams,
    Pack,
    Solids,
    Surroundings,
    cast_beams,
    flown_rows,
    solids_within,
    spread_pulses,
    standing,
    surroundings,
)
from sionna_radar.report.page.world import (
    box_of,
    colour_scales,
    frame_of_page,
    packed_track,
    rim_of,
    track_of,
)
from sionna_radar.report.terminal import number
from sionna_radar.scenario import to_toml
from sionna_radar.scene.raycast import RayCaster
from sionna_radar.survey.checks import BoresightHits, boresight_hits
from sionna_radar.survey.preparation import Prepared

PULSES, FOOTPRINTS = 240, 60
MAX_CELLS = 50_000


def show_page(prepared: Prepared, name: str, coordinates: Coordinates = Coordinates.MAP) -> str:
    """Return the page of a prepared survey as HTML.

    Parameters
    ----------
    prepared:
        The survey.
    name:
        What it was called; the title of a scenario without a description.
    coordinates:
        Those of the axes.

    Raises
    ------
    OutputError
        The page would be too large, or plotly is not installed.

    """
    frame, pack = frame_of(prepared.scene.scene.georeference, coordinates), Pack()
    index = spread_pulses(len(prepared), PULSES)
    beams, hits = cast_beams(prepared, index), boresight_hits(prepared.flight, prepared.scene)
    solids = solids_within(prepared.scene.scene, prepared.scenario.terrain.kind, box_of(prepared))
    ground = _ground(prepared, solids)
    numbers = {
        "frame": frame_of_page(frame),
        "scales": colour_scales(),
        "chosen": len(index) // 2,
        "world": _world(prepared, pack, frame, ground, solids, beams, hits),
    }
    title = prepared.scenario.description or name
    body = _body(prepared, title, len(index), beams, hits, solids)
    return document(title, body, pack.text(numbers), ("world.js",))


def _ground(prepared: Prepared, solids: Solids | None) -> Surroundings:
    """Return the ground under what is drawn as triangles; the highest surface where nothing is."""
    built, box = prepared.scene, box_of(prepared)
    lying = [surface for surface in built.scene.surfaces if not standing(surface, prepared.scenario.terrain.kind)]
    if solids is None or not lying:
        return surroundings(built.caster, built.scene, box, MAX_CELLS)
    return surroundings(RayCaster(lying), built.scene, box, MAX_CELLS)


def _world(
    prepared: Prepared,
    pack: Pack,
    frame: Frame,
    ground: Surroundings,
    solids: Solids | None,
    beams: Beams,
    hits: BoresightHits,
) -> dict[str, Any]:
    """Return the view in three dimensions."""
    height, track = ground.height_m[np.isfinite(ground.height_m)], track_of(prepared.flight)
    low, high = (float(height.min()), float(height.max())) if height.size else (-0.5, 0.5)
    top = max(high, float(track[:, 2].max()), float(solids.vertices_m[:, 2].max()) if solids else high)
    west, east, south, north = box_of(prepared)
    up, pad = frame.origin_m[2], 0.04 * (top - low) + 0.1
    span = (low, high) if high - low > 1e-3 else (low - 0.5, low + 0.5)
    return {
        "shapes": [{"name": "ground", **ground.packed(pack)}],
        "paints": [{"name": "Height (m)", "scale": "height", "low": span[0] + up, "high": span[1] + up}],
        "solids": solids.packed(pack) if solids else None,
        "rim": pack.exact(_rim(prepared)),
        "footprints": pack.exact(_rings(beams)) if beams.outline_m.shape[1] else None,
        "hits": pack.exact(hits.hit_m),
        "track": packed_track(pack, prepared.flight),
        "beams": beams.packed(pack),
        "bounds": [[west, south, low - pad], [east, north, top + pad]],
    }


def _rim(prepared: Prepared) -> Float[np.ndarray, "n 3"]:
    """Return the edge of the DEM, a little above the surface."""
    edge = rim_of(prepared.mapper.grid)
    height_m = prepared.scene.caster.from_above(edge, float(prepared.scene.scene.bounds_m[1, 2]) + CLEAR_M)
    return np.column_stack([edge, height_m + 0.1])


def _rings(beams: Beams) -> Float[np.ndarray, "n 3"]:
    """Return the outlines of some footprints, one after another with a gap between them."""
    rows = np.linspace(0, len(beams.fan) - 1, min(FOOTPRINTS, len(beams.fan))).round().astype(int)
    rings = beams.outline_m[np.unique(rows)]
    above = np.array([0.0, 0.0, 0.05])
    closed = np.concatenate([rings, rings[:, :1], np.full((len(rings), 1, 3), np.nan)], axis=1)
    return (closed + above).reshape(-1, 3)


def _body(prepared: Prepared, title: str, pulses: int, beams: Beams, hits: BoresightHits, solids: Solids | None) -> str:
    heard = np.isfinite(hits.range_m)
    range_m = hits.range_m[heard]
    rings = beams.outline_m
    wide = np.linalg.norm(np.ptp(rings, axis=1), axis=-1) if rings.shape[1] else np.zeros(0)
    wide = wide[np.isfinite(wide)]
    trajectory = prepared.flight.trajectory
    start, end = trajectory.cruise_s()
    west, east, south, north = prepared.mapper.grid.extent_m
    nothing = float("nan")
    tiles = [
        markup.Tile(value=f"{len(prepared.flight):,}", name="pulses", note=f"in {end - start:.1f} s of flight"),
        markup.Tile(
            value=f"{number(range_m.min() if range_m.size else nothing, '.1f')} to "
            f"{number(range_m.max() if range_m.size else nothing, '.1f', ' m')}",
            name="range to the ground",
            note=f"{prepared.receiver.chirp.max_range_m:.0f} m can be measured",
        ),
        markup.Tile(
            value=number(float(np.median(wide)) if wide.size else nothing, ".2g", " m"),
            name="footprint",
            note="diagonal of its box at half power, median",
        ),
        markup.Tile(
            value=f"{east - west:.0f} x {north - south:.0f} m", name="area of the DEM", note="dashed in the view"
        ),
        markup.Tile(value=f"{1 - heard.mean():.1%}", name="beams without ground", note="of the axes"),
    ]
    switches = {
        "track": "flight",
        "rim": "edge of the DEM",
        "footprints": "footprints",
        "hits": "beam axes on the ground",
    }
    shown = [markup.switch(key, label) for key, label in switches.items()] + [markup.switch("beam", "beam")]
    shown += [markup.switch("solids", "buildings and objects")] if solids else []
    notes = (
        f"Dots: where the beam axes of pulses spread over the flight meet the ground (the swath). Orange rings: "
        f"footprints at half power of {min(FOOTPRINTS, pulses)} pulses. Nothing is traced yet: "
        "rays are cast against the scene. "
    )
    return markup.head("Scenario", title, {"world-view": "In three dimensions", "flown": "Settings"}) + "\n".join(
        [
            markup.section(
                "world-view",
                "Before it is flown",
                markup.warnings(prepared.warnings + prepared.flown.warnings),
                markup.tiles(tiles),
                markup.controls(
                    markup.choice("upright", "Heights", ["to scale", "x 2", "x 4"]),
                    *shown,
                    markup.slider("pulse-world", "Pulse", pulses - 1, pulses // 2),
                ),
                markup.plot("world", "world"),
                markup.paragraph(
                    notes + (f"Of what stands there, {solids.note}." if solids and solids.note else ""), "note"
                ),
            ),
            markup.section(
                "flown",
                "Settings",
                markup.pairs(flown_rows(prepared)),
                markup.folded("The resolved scenario", to_toml(prepared.scenario)),
            ),
        ]
    )


PAGE_FILE = SignedFile(command="show", before="<!-- ", after=" -->", at_end=True)
