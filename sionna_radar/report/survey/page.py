"""The page of a survey, `report.html`: its flight, errors, maps, scene and chirps, in one file.

Errors are shown as a table beside the reference paper's, as a distribution, and as a map. Chirps are those of pulses
sampled over the survey, traced again, with their detections.
"""

from typing import Any

import numpy as np
from jaxtyping import Int

from sionna_radar.foundation.linear_algebra import on_one_thread
from sionna_radar.foundation.raster import Raster
from sionna_radar.foundation.sequences import spread_indices
from sionna_radar.report.coordinates import Coordinates, Frame, frame_of
from sionna_radar.report.page.beams import Beams, cast_beams
from sionna_radar.report.page.scene_data import (
    MAX_RELIEF_CELLS,
    Pack,
    box_of,
    flown_rows,
    packed_points,
    packed_track,
    points_to_draw,
    sigma0_db,
    surroundings,
    thinned,
    track_of,
)
from sionna_radar.report.page.sections import (
    bounds_of,
    chirps_that_fit,
    errors_section,
    level_map,
    maps_of,
    page_of,
    painted,
    span_of,
)
from sionna_radar.report.survey.obstacles import drawn_obstacles, obstacles_section
from sionna_radar.report.survey.summary import crs_name, reference_for, summary
from sionna_radar.report.terminal import number
from sionna_radar.scenario import to_toml
from sionna_radar.survey.result import Survey
from sionna_radar.survey.sensors.sensor import SensorWithChirps
from sionna_radar.survey.sensors.sweeps import ChirpRecord

# Largest number of chirps of a custom sensor that records one at a time.
MAX_ONE_BY_ONE = 40
# Limit of the paths that are traced again for the chirps: wide beams over fixed scatterers have tens of thousands per
# pulse.
MAX_PATHS, MIN_CHIRPS, AT_ONCE = 200_000, 12, 64


def chirps_of(survey: Survey, index: Int[np.ndarray, " pulse"]) -> Int[np.ndarray, " chirp"]:
    """Return an even subset of pulses whose chirps fit the page's limits of size and time."""
    fitting = min(chirps_that_fit(survey.chirp), max(MIN_CHIRPS, MAX_PATHS * survey.pulses // max(survey.paths, 1)))
    return index[:: -(-len(index) // fitting)] if fitting and len(index) else index[:0]


@on_one_thread
def record_chirps(survey: Survey, index: Int[np.ndarray, " pulse"]) -> list[ChirpRecord]:
    """Return the chirp records of some pulses; fewer from a sensor that records one at a time."""
    if len(index) == 0:
        return []
    sensor, flight = survey.sensor or survey.prepared.build_sensor(), survey.prepared.flight
    if isinstance(sensor, SensorWithChirps):
        blocks = np.array_split(index, -(-len(index) // AT_ONCE))
        return [record for block in blocks for record in sensor.record_chirps(flight.pulses(block))]
    stride = -(-len(index) // MAX_ONE_BY_ONE)
    records = (sensor.record_chirp(flight.pulses(index[row : row + 1])) for row in range(0, len(index), stride))
    return [record for record in records if record is not None]


PULSES = 240
MAX_ECHOES_OF_BEAMS = 4_000
AROUND_CELLS = 12_000


def survey_page(survey: Survey, coordinates: Coordinates = Coordinates.MAP) -> str:
    """Return the page of a survey as HTML. Raises OutputError if it would be too large, or plotly is not installed."""
    frame, pack = frame_of(survey.georeference, coordinates), Pack()
    index = spread_indices(PULSES, survey.pulses)
    beams = cast_beams(survey.prepared, index)
    thin = thinned(survey.dem.grid, MAX_RELIEF_CELLS)
    sigma0 = None
    if survey.scenario.sensor != "lidar":
        truth = Raster(grid=thin.cells, height_m=thin.of(survey.truth.height_m))
        level_db = sigma0_db(survey.prepared, truth.within(thin.of(survey.lit)))
        sigma0 = Raster(grid=thin.cells, height_m=level_db) if np.isfinite(level_db).any() else None
    maps, notes = maps_of(pack, frame, survey, survey)
    if sigma0 is not None:
        name = "Backscatter coefficient of the ground"
        maps.append(level_map(pack, frame, sigma0.grid, sigma0.height_m, name, "sigma0 (dB)"))
    world, omissions = _world(survey, pack, frame, beams, sigma0)
    return page_of(
        "survey.html",
        survey,
        survey,
        pack,
        frame,
        pulses=index,
        records=record_chirps(survey, chirps_of(survey, index)),
        maps=maps,
        world=world,
        numbers={"summary": summary(survey)},
        title=survey.scenario.description or "A survey",
        tiles=[
            *_accuracy_tiles(survey),
            (f"{len(survey.points):,}", "echoes", f"of {survey.pulses:,} pulses"),
            (f"{survey.paths:,}", "paths traced", "in all"),
        ],
        flown=flown_rows(survey.prepared)
        | {"Coordinates": crs_name(survey.georeference)}
        | {f"{key} replaced by": part for key, part in survey.replaced.items()},
        lidar=survey.scenario.sensor == "lidar",
        beams=True,
        world_notes=omissions,
        map_notes=notes,
        replaced=survey.replaced,
        settings_title="The resolved scenario",
        scenario=to_toml(survey.scenario),
        readings=survey.readings.described() if survey.readings else {},
        **obstacles_section(survey.obstacles),
        readings_of=survey.readings.subject if survey.readings else "",
        **(
            errors_section(survey, survey.breakdown, survey.dem_uncertainty, *reference_for(survey.prepared))
            if survey.readings is None
            else {"error_rows": []}
        ),
    )


def _accuracy_tiles(survey: Survey) -> list[tuple[str, str, str]]:
    """Return the errors of the map, or of readings that make none: value, name and meaning."""
    lit = survey.lit_error
    if survey.readings is None and survey.off_wall_error is not None:
        return [
            (number(lit.nmad_m, ".3f", " m"), "NMAD", "of lit cells; outliers do not count"),
            (number(lit.le90_m, ".3f", " m"), "LE90", "90th percentile of |error|"),
            (number(100 * lit.over_1m, ".2f", " %"), "over 1 m", "cells on the wrong side of a wall"),
            (f"{lit.coverage:.1%}", "coverage", "of lit cells"),
            (number(lit.rms_m, ".3f", " m"), "RMS error", "of lit cells, DEM minus truth"),
        ]
    if survey.readings is None:
        return [
            (number(lit.rms_m, ".3f", " m"), "RMS error", "of lit cells, DEM minus truth"),
            (number(lit.mean_m, "+.3f", " m"), "mean error", "bias"),
            (number(lit.le90_m, ".3f", " m"), "LE90", "90th percentile of |error|"),
            (f"{lit.coverage:.1%}", "coverage", "of lit cells"),
        ]
    errors, latency_s = survey.readings.errors, survey.readings.latency_s
    return [
        (number(errors.bias_m, "+.2f", " m"), "mean error", f"reading less {survey.readings.subject}"),
        (number(errors.le95_m, ".2f", " m"), "LE95", "95th percentile of |error|"),
        (number(np.nan if latency_s is None else latency_s, "+.3f", " s"), "latency", "positive: late"),
        (number(errors.lowest_clearance_m, ".1f", " m"), "lowest clearance", "over what stands below"),
    ]


def _world(
    survey: Survey, pack: Pack, frame: Frame, beams: Beams, sigma0: Raster | None
) -> tuple[dict[str, Any], list[str]]:
    prepared = survey.prepared
    thin = thinned(survey.dem.grid, MAX_RELIEF_CELLS)
    truth, dem = (type(r)(grid=thin.cells, height_m=thin.of(r.height_m)) for r in (survey.truth, survey.dem))
    around = surroundings(prepared.world.caster, prepared.world.scene, box_of(prepared), AROUND_CELLS, thin.cells)
    drawn = points_to_draw(len(survey.points))
    echoes = np.flatnonzero(np.isin(survey.points.pulse, beams.pulses.index))[:MAX_ECHOES_OF_BEAMS]
    track = track_of(prepared.flight)
    world = painted(pack, frame, {"True surface": truth, "DEM": dem}, thin.of(survey.error.height_m))
    if sigma0 is not None:
        bottom, top = span_of(sigma0.height_m, share=1.0)
        levels = pack.rounded(sigma0.height_m, 0.1)
        world["paints"].append({"name": "sigma0 (dB)", "scale": "level", "low": bottom, "high": top, "z": levels})
    world |= {
        "around": around.packed(pack),
        "track": packed_track(pack, prepared.flight),
        "points": packed_points(pack, survey.points, drawn),
        "echoes": packed_points(pack, survey.points, echoes),
        "beams": beams.packed(pack),
        **drawn_obstacles(pack, survey),
        "bounds": bounds_of(box_of(prepared), around.height_m, truth.height_m, dem.height_m, track[:, 2]),
    }
    notes = [f"View in three dimensions: {thin.note}."] if thin.note else []
    if len(drawn) < len(survey.points):
        notes.append(f"View in three dimensions: {len(drawn):,} of {len(survey.points):,} echoes are drawn.")
    return world, notes
