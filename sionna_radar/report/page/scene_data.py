"""The three-dimensional data of a page: relief, solids, beams, echoes and the flight, packed for the browser.

    length of the JSON (4 bytes, little-endian) | JSON, padded to 8 bytes | arrays, each at a multiple of 8 bytes

An array is represented in the JSON as {"at": offset, "type": "u2", "shape": [...], "step": 0.001, "zero": 12.5}; its
values are `zero + step * number`, and the largest number represents NaN. Base64 cannot end a script element, so that no
text inside needs escaping; `core.js` is the reader.
"""

import base64
import json
import zlib
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Inexact, Int
from scipy.spatial import cKDTree

from sionna_radar.flight.pulses import PulseSchedule
from sionna_radar.foundation.raster import Grid, Raster
from sionna_radar.mapping.points import Points
from sionna_radar.report.files.contents import jsonable
from sionna_radar.scene.build import CLEAR_M
from sionna_radar.scene.model import Scene, Surface
from sionna_radar.scene.raycast import RayCaster
from sionna_radar.survey.preparation import Prepared

EMPTY = 65_535
# Compression level: higher ones shorten a page by a tenth and take three times as long.
LEVEL = 1


class Pack:
    """The arrays of a page."""

    def __init__(self) -> None:
        self._parts: list[bytes] = []
        self._size = 0

    def rounded(self, values: Inexact[np.ndarray, "..."], step: float) -> dict[str, Any]:
        """Return the place of values rounded to a step, in 16 bits; the step is coarser for a large span."""
        values = np.asarray(values, dtype=np.float64)
        finite = np.isfinite(values)
        low, high = (float(values[finite].min()), float(values[finite].max())) if finite.any() else (0.0, 0.0)
        step = max(step, (high - low) / (EMPTY - 1))
        numbers = np.full(values.shape, EMPTY, dtype="<u2")
        numbers[finite] = np.round((values[finite] - low) / step)
        return {**self._keep(numbers, "u2"), "step": step, "zero": low}

    def exact(self, values: Float[np.ndarray, "..."]) -> dict[str, Any]:
        """Return the place of values as 32-bit floats."""
        return self._keep(np.asarray(values, dtype="<f4"), "f4")

    def whole(self, values: Int[np.ndarray, "..."]) -> dict[str, Any]:
        """Return the place of whole numbers."""
        return self._keep(np.asarray(values, dtype="<i4"), "i4")

    def _keep(self, array: np.ndarray, kind: str) -> dict[str, Any]:
        content = np.ascontiguousarray(array).tobytes()
        place = {"at": self._size, "type": kind, "shape": list(array.shape)}
        padding = -len(content) % 8
        self._parts.append(content + b"\0" * padding)
        self._size += len(content) + padding
        return place

    def text(self, document: dict[str, Any]) -> str:
        """Return a document with the places of arrays, followed by these arrays, as text."""
        head = json.dumps(jsonable(document), allow_nan=False, separators=(",", ":")).encode("utf-8")
        head += b" " * (-(len(head) + 4) % 8)
        return compressed(len(head).to_bytes(4, "little") + head + b"".join(self._parts))


def compressed(content: bytes) -> str:
    """Return bytes as compressed base64."""
    return base64.b64encode(zlib.compress(content, LEVEL)).decode("ascii")


# Cells of one map, and of one surface in three dimensions.
MAX_MAP_CELLS, MAX_RELIEF_CELLS = 400_000, 60_000
HEIGHT_STEP_M = 0.001
# Depth of the surroundings under the edge of a map: constant part, and share of their cells.
UNDER_M, UNDER_SHARE = 0.05, 0.1


@dataclass(frozen=True, kw_only=True)
class Thinned:
    """Every n-th cell of a grid, along both of its axes."""

    grid: Grid
    every: int

    @property
    def cells(self) -> Grid:
        """The grid of the remaining cells."""
        grid, n = self.grid, self.every
        return Grid(
            west_m=grid.west_m,
            south_m=grid.south_m,
            spacing_m=grid.spacing_m * n,
            columns=-(-grid.columns // n),
            rows=-(-grid.rows // n),
        )

    def of(self, values: np.ndarray) -> np.ndarray:
        """Return the values of the remaining cells."""
        return values[:: self.every, :: self.every]

    @property
    def note(self) -> str:
        """Description of omitted cells; empty for none."""
        if self.every == 1:
            return ""
        ordinal = f"{self.every}{ {2: 'nd', 3: 'rd'}.get(self.every, 'th') }"
        return f"every {ordinal} cell each way is shown ({self.grid.spacing_m * self.every:g} m)"


def thinned(grid: Grid, most: int) -> Thinned:
    """Return a grid thinned to at most `most` cells."""
    every = max(1, int(np.sqrt(grid.columns * grid.rows / most)))
    while -(-grid.columns // every) * -(-grid.rows // every) > most:
        every += 1
    return Thinned(grid=grid, every=every)


def packed_map(
    pack: Pack,
    grid: Grid,
    values: Float[np.ndarray, "row column"],
    step: float = HEIGHT_STEP_M,
    origin_m: tuple[float, ...] = (0.0, 0.0),
) -> dict[str, Any]:
    """Return a map for a page: the first cell's centre in displayed coordinates, the spacing, and rounded values."""
    axes = {"x0": grid.west_m + origin_m[0], "y0": grid.south_m + origin_m[1], "step": grid.spacing_m}
    return {**axes, "z": pack.rounded(values, step)}


@dataclass(frozen=True, kw_only=True)
class Surroundings:
    """The highest surface around a map, on grid lines that include the map's first and last.

    Plotly drops cells next to empty ones: the surface extends by one cell under the map, slightly lower, and is empty
    inside.
    """

    x_m: Float[np.ndarray, " column"]
    y_m: Float[np.ndarray, " row"]
    height_m: Float[np.ndarray, "row column"]

    def packed(self, pack: Pack) -> dict[str, Any]:
        """Return the surface for a page."""
        return {"x": pack.exact(self.x_m), "y": pack.exact(self.y_m), "z": pack.rounded(self.height_m, HEIGHT_STEP_M)}


def surroundings(
    caster: RayCaster, scene: Scene, box: tuple[float, float, float, float], most: int, inner: Grid | None = None
) -> Surroundings:
    """Return the highest surface in a box (west, east, south, north) of a scene, in about `most` cells.

    caster: of the included surfaces. inner: an excluded map.
    """
    west, east, south, north = box
    step_m = max(float(np.sqrt((east - west) * (north - south) / most)), 1e-3)
    x = _lines(west, east, inner.x_m if inner else None, step_m)
    y = _lines(south, north, inner.y_m if inner else None, step_m)
    across, along = np.meshgrid(x, y)
    places = np.column_stack([across.ravel(), along.ravel()])
    height = caster.from_above(places, float(scene.bounds_m[1, 2]) + CLEAR_M).reshape(across.shape)
    if inner:
        for depth_m, value in ((0.0, -UNDER_M - UNDER_SHARE * step_m), (step_m, np.nan)):
            columns, rows = (
                (v > edges[0] + depth_m) & (v < edges[-1] - depth_m) for v, edges in ((x, inner.x_m), (y, inner.y_m))
            )
            height[np.ix_(rows, columns)] += value
    return Surroundings(x_m=x, y_m=y, height_m=height)


def _lines(
    low: float, high: float, inner: Float[np.ndarray, " cell"] | None, step_m: float
) -> Float[np.ndarray, " line"]:
    """Return grid lines from low to high about a step apart, including the ends of an inner map and a step within."""
    inner_low, inner_high = (low, high) if inner is None else (float(inner[0]), float(inner[-1]))
    stops = np.unique(np.clip([low, inner_low, inner_low + step_m, inner_high - step_m, inner_high, high], low, high))
    segments = [np.linspace(a, b, max(1, round((b - a) / step_m)), endpoint=False) for a, b in pairwise(stops)]
    return np.concatenate([*segments, stops[-1:]])


# Share of steep area, and its cosine limit, from which a surface counts as standing on the ground.
STEEP_SHARE, STEEP_COSINE = 0.1, 0.2
MAX_FACES = 60_000
CITY = "sionna:"


@dataclass(frozen=True, kw_only=True)
class Solids:
    """Triangles, and their total number within the box."""

    vertices_m: Float[np.ndarray, "vertex 3"]
    faces: Int[np.ndarray, "face 3"]
    total: int

    @property
    def note(self) -> str:
        """Description of omitted triangles; empty for none."""
        if self.total == len(self.faces):
            return ""
        return f"the {len(self.faces):,} largest of {self.total:,} triangles of buildings are shown"

    def packed(self, pack: Pack) -> dict[str, Any]:
        """Return the triangles for a page."""
        return {"vertices": pack.exact(self.vertices_m), "faces": pack.whole(self.faces)}


def standing(surface: Surface, terrain: str) -> bool:
    """Return True if a surface stands on the ground: by its builder's name, or by its steep area.

    terrain: the kind of terrain; the roofs of Sionna's cities are separate surfaces.
    """
    names = ("building-", "footprints-", *([f"{terrain.removeprefix(CITY)}-"] if terrain.startswith(CITY) else []))
    if surface.name.startswith(names):
        return True
    normal = _normals(surface.vertices_m, surface.faces)
    area = np.linalg.norm(normal, axis=1)
    steep = np.abs(normal[:, 2]) < STEEP_COSINE * area
    return bool(area[steep].sum() > STEEP_SHARE * area.sum())


def solids_within(scene: Scene, terrain: str, box: tuple[float, float, float, float]) -> Solids | None:
    """Return the meshes of standing objects within a box (west, east, south, north); None if there are none."""
    vertices, faces, offset = [], [], 0
    for surface in (surface for surface in scene.surfaces if standing(surface, terrain)):
        selected = surface.faces[_within(surface, box)]
        if len(selected):
            vertex, index = np.unique(selected, return_inverse=True)
            vertices.append(surface.vertices_m[vertex])
            faces.append(index.reshape(-1, 3) + offset)
            offset += len(vertex)
    if not faces:
        return None
    vertices_m, triangles = np.concatenate(vertices), np.concatenate(faces)
    total = len(triangles)
    if total > MAX_FACES:
        area = np.linalg.norm(_normals(vertices_m, triangles), axis=1)
        triangles = triangles[np.argsort(-area, kind="stable")[:MAX_FACES]]
    return Solids(vertices_m=vertices_m, faces=triangles, total=total)


def _within(surface: Surface, box: tuple[float, float, float, float]) -> Bool[np.ndarray, " face"]:
    west, east, south, north = box
    x, y = surface.vertices_m[:, 0], surface.vertices_m[:, 1]
    in_box = (x >= west) & (x <= east) & (y >= south) & (y <= north)
    return in_box[surface.faces].any(axis=1)


def _normals(
    vertices_m: Float[np.ndarray, "vertex 3"], faces: Int[np.ndarray, "face 3"]
) -> Float[np.ndarray, "face 3"]:
    a, b, c = (vertices_m[faces[:, corner]] for corner in range(3))
    return np.cross(b - a, c - a)


LOOKS = 20_000
ABOVE_M = 0.01


def sigma0_db(prepared: Prepared, surface: Raster) -> Float[np.ndarray, "row column"]:
    """Return sigma0 in dB of the cells of a surface, NaN where undefined; `survey.html` explains it."""
    scene, caster = prepared.world.scene, prepared.world.caster
    pose = prepared.flight.sample(LOOKS).true
    range_m = caster.cast(pose.position_m, pose.boresight).distance_m
    met = np.isfinite(range_m)
    cells = np.column_stack([surface.grid.centres_m, surface.height_m.ravel()])
    filled = np.isfinite(cells[:, 2])
    value = np.full(len(cells), np.nan)
    if not (met.any() and filled.any()):
        return value.reshape(surface.grid.shape)
    origin = pose.position_m[met]
    hit = origin + range_m[met, None] * pose.boresight[met]
    _, nearest = cKDTree(hit[:, :2]).query(cells[filled, :2])
    ray = cells[filled] + [0.0, 0.0, ABOVE_M] - origin[nearest]
    distance = np.linalg.norm(ray, axis=1)
    cast = caster.cast(origin[nearest], ray / distance[:, None])
    visible = cast.hit & (np.abs(cast.distance_m - distance) < 0.05 + 0.002 * distance)
    linear = np.full(len(ray), np.nan)
    for number, mesh in enumerate(scene.surfaces):
        rows = visible & (cast.surface == number)
        linear[rows] = scene.materials[mesh.material].sigma0(np.arccos(cast.cosine[rows]))
    value[filled] = 10 * np.log10(np.where(linear > 0, linear, np.nan))
    return value.reshape(surface.grid.shape)


MAX_TRACK, MAX_POINTS = 2_000, 15_000
# Margin around the map and the flight, as a share of the longer side.
MARGIN = 0.08


def track_of(schedule: PulseSchedule) -> Float[np.ndarray, "n 3"]:
    """Return positions along a flight, evenly spaced in time."""
    return schedule.trajectory.position(np.linspace(0.0, schedule.trajectory.end_s, MAX_TRACK))


def box_of(prepared: Prepared) -> tuple[float, float, float, float]:
    """Return the box (west, east, south, north) around a survey's map and flight, no larger than its scene."""
    west, east, south, north = prepared.mapper.grid.extent_m
    track = track_of(prepared.flight)
    (left, low), (right, top) = track[:, :2].min(axis=0), track[:, :2].max(axis=0)
    west, east, south, north = min(west, left), max(east, right), min(south, low), max(north, top)
    pad = MARGIN * max(east - west, north - south)
    (left, low, _), (right, top, _) = prepared.world.scene.bounds_m
    return (
        float(max(west - pad, left)),
        float(min(east + pad, right)),
        float(max(south - pad, low)),
        float(min(north + pad, top)),
    )


def packed_track(pack: Pack, schedule: PulseSchedule) -> dict[str, Any]:
    """Return a flight for a page: positions and times."""
    time_s = np.linspace(0.0, schedule.trajectory.end_s, MAX_TRACK)
    return {"position": pack.exact(track_of(schedule)), "time_s": pack.exact(time_s)}


def packed_points(pack: Pack, points: Points, rows: Int[np.ndarray, " n"]) -> dict[str, Any]:
    """Return some points for a page: positions and pulses."""
    return {"position": pack.exact(points.position_m[rows]), "pulse": pack.whole(points.pulse[rows])}


def points_to_draw(count: int, most: int = MAX_POINTS) -> Int[np.ndarray, " n"]:
    """Return the rows of points to draw: all, or a fixed random choice, free of aliasing with the scan."""
    return np.sort(np.random.default_rng(0).permutation(count)[:most])


def flown_rows(prepared: Prepared) -> dict[str, str]:
    """Return the main settings of a survey by their names."""
    scenario, chirp, grid = prepared.scenario, prepared.receiver.chirp, prepared.mapper.grid
    start, end = prepared.flight.trajectory.cruise_s()
    tilt_deg = np.rad2deg(prepared.flight.scan.incidence_rad)
    rows = {
        "Ground": scenario.terrain.kind,
        "Things on it": _things(prepared),
        "Weather": scenario.weather.falling or "clear",
        "Height above ground": f"{prepared.plan.flown.altitude_m:.4g} m",
        "Speed": f"{prepared.plan.flown.speed_mps:.4g} m/s",
        "Time in the air": f"{end - start:.1f} s, {len(prepared.flight):,} pulses",
        "Sensor": scenario.sensor,
        "Scan": f"{scenario.radar.scan.mode.replace('_', ' ')}, {tilt_deg:.3g} deg from nadir",
        "Beam at half power": "" if scenario.sensor == "lidar" else _beam(prepared),
    }
    if scenario.sensor in ("radar", "mimo"):
        rows |= {
            "Carrier": f"{chirp.carrier_hz / 1e9:.5g} GHz",
            "Sweep": f"{chirp.bandwidth_hz / 1e6:.5g} MHz, {scenario.radar.sweep}",
            "Range cell, farthest": f"{chirp.range_resolution_m:.3g} m, {chirp.max_range_m:.4g} m",
            "Ranges": scenario.processing.ranging if scenario.sensor == "radar" else "",
            "Noise": _noise(prepared),
        }
    rows |= {
        **_rates(prepared),
        "Navigation": "pose known exactly" if prepared.flight.navigation is None else scenario.platform.navigation.kind,
        "Map": f"{prepared.mapper.name}, {grid.columns} x {grid.rows} cells of {grid.spacing_m:g} m",
        "Seed": str(scenario.seed),
    }
    return {name: value for name, value in rows.items() if value}


def _rates(prepared: Prepared) -> dict[str, str]:
    """Return the rate of pulses; of an array, of frames and of the chirps that they consist of."""
    frames, rate = prepared.instrument.frames, f"{prepared.instrument.mean_rate_hz:.4g} Hz"
    if frames is None:
        return {"Pulse rate": rate}
    chirps = f"{frames.chirps_per_frame:,} chirps, {prepared.local.radar.chirp_rate_hz / 1e3:.4g} kHz"
    return {"Frame rate": rate, "Chirps of a frame": chirps}


def _things(prepared: Prepared) -> str:
    scenario = prepared.scenario
    counts = {
        "buildings": len(scenario.buildings),
        "objects": len(scenario.objects),
        "files of footprints": len(scenario.footprints),
        "point targets": len(prepared.world.scene.targets),
    }
    return ", ".join(f"{name}: {count:,}" for name, count in counts.items() if count)


def _beam(prepared: Prepared) -> str:
    azimuth, elevation = np.rad2deg(prepared.instrument.antenna.beamwidths_rad)
    steered = f", steered to {len(prepared.instrument.beams)} places" if prepared.instrument.beams else ""
    return f"{azimuth:.3g} x {elevation:.3g} deg{steered}"


def _noise(prepared: Prepared) -> str:
    radar = prepared.scenario.radar
    return (
        f"{radar.system_noise_figure_db:.4g} dB figure"
        if radar.snr_db is None
        else f"{radar.snr_db:g} dB SNR of a sample"
    )
