"""Builder of thin obstacles: wires over the ground or from files with their pylons, poles, and fences."""

import logging
from collections.abc import Iterator
from itertools import pairwise

import numpy as np
from jaxtyping import Float
from scipy.constants import speed_of_light
from scipy.spatial.transform import Rotation

from sionna_radar.elevation.local_frame import MapFrame
from sionna_radar.foundation.errors import InputFileError, ScenarioError
from sionna_radar.foundation.raster import Heights
from sionna_radar.scenario import Scenario
from sionna_radar.scenario.thin import FenceTable, PoleTable, ThinTable, WireTable
from sionna_radar.scene.footprints import height_of
from sionna_radar.scene.raycast import RayCaster
from sionna_radar.scene.vector_file import VectorQuery, read_lines
from sionna_radar.scene.wires import Strands, ThinObstacle, Wire, branch, lattice_mast, offset_line
from sionna_radar.surfaces.build import permittivity_of

logger = logging.getLogger("sionna_radar")

# Wires are held against the ground and against buildings at points this far apart, m.
CHECKED_M = 2.0
# A pole or a wire's end may reach this far into the ground, m: heights are interpolated.
INTO_GROUND_M, TOUCHING_M = 0.3, 0.05
# Widths of supports, where none are given: of a pole, and of a lattice mast over its height.
POLE_M, MAST_FOOT, MAST_TOP = 0.3, 1 / 6, 1 / 20
# Members of lattice masts under wires, m.
MEMBER_M = 0.1
# Lobes of a stranded conductor on each side of the broadside: the thickest of power lines has 45 at 140 GHz.
MAX_LOBES = 100
# Longest line of a scenario in all, m: 10,000 km have 3 million pieces. Most cylinders of a scenario: wires, poles,
# posts and members of masts; 100,000 take 6 s and 300 MB.
MAX_LENGTH_M, MAX_CYLINDERS = 1e7, 100_000
# Highest wire above the ground, m: tethers of balloons reach 5 km.
HIGHEST_M = 10_000.0

Line = Float[np.ndarray, "vertex 3"]
Window = tuple[float, float, float, float]


def build_thin(
    scenario: Scenario, ground_m: Heights, datum_m: float, frame: MapFrame | None, window_m: Window, caster: RayCaster
) -> tuple[ThinObstacle, ...]:
    """Return the wires, poles and fences of a scenario.

    ground_m: height of the bare ground at horizontal positions; NaN beyond the terrain.
    datum_m: height of the local origin in the heights of the terrain.
    frame, window_m: position of the local frame on the map, and the extent visible to the survey (west, south, east,
        north), within which files are read.
    caster: rays against all surfaces, for wires that lead through buildings.

    Raises ScenarioError, InputFileError if one hangs under the ground or stands beyond the terrain, or a file cannot be
        used.
    """

    def each() -> Iterator[ThinObstacle]:
        """Yield wires with their pylons, then poles, then fences."""
        for index, wire in enumerate(scenario.wires):
            yield from _wires(wire, f"wires.{index}", scenario, ground_m, datum_m, frame, window_m)
        for index, pole in enumerate(scenario.poles):
            yield _pole(pole, f"poles.{index}", scenario, ground_m)
        for index, fence in enumerate(scenario.fences):
            yield _fence(fence, f"fences.{index}", scenario, ground_m)

    obstacles: list[ThinObstacle] = []
    cylinders, length_m = 0, 0.0
    for one in each():
        cylinders += len(one.wires)
        _check_cylinders(cylinders, one.name.split("-")[0])
        length_m += sum(_length_m(wire.vertex_m) for wire in one.wires)
        _check_length(length_m, one.name)
        obstacles.append(one)
    for one in obstacles:
        if one.kind == "wires":
            _warn_of_buildings(one, caster)
    return tuple(obstacles)


def _length_m(line: Line) -> float:
    return float(np.linalg.norm(np.diff(line, axis=0), axis=1).sum())


def _check_length(length_m: float, key: str) -> None:
    if length_m > MAX_LENGTH_M:
        message = f"have {length_m / 1000:,.0f} km in all, more than {MAX_LENGTH_M / 1000:,.0f}; cut out what is flown"
        raise ScenarioError.of(key.split(".")[0], message)


def _check_cylinders(count: int, key: str) -> None:
    if count > MAX_CYLINDERS:
        message = f"has the {count:,}th wire, post or member of a mast of the scenario, more than {MAX_CYLINDERS:,}; "
        raise ScenarioError.of(key, message + "give fewer, or cut out what is flown")


def _reflectivity(table: ThinTable, key: str, scenario: Scenario) -> float:
    if table.medium is None:
        return 1.0
    try:
        root = np.sqrt(permittivity_of(table.medium, scenario.radar.carrier_hz))
    except ValueError as error:
        raise ScenarioError.of(f"{key}.medium", f"{error}") from error
    return float(abs((1 - root) / (1 + root)) ** 2)


def _wires(
    table: WireTable,
    key: str,
    scenario: Scenario,
    ground_m: Heights,
    datum_m: float,
    frame: MapFrame | None,
    window_m: Window,
) -> Iterator[ThinObstacle]:
    reflectivity = _reflectivity(table, key, scenario)
    strands = None
    if table.strands is not None and table.lay_mm is not None:
        strands = Strands(count=table.strands, lay_m=table.lay_mm / 1000)
        lobes = 2 * strands.period_m * scenario.radar.carrier_hz / speed_of_light
        if lobes > MAX_LOBES:
            message = (
                f"gives {lobes:,.0f} lobes on either side, more than {MAX_LOBES}; give the length of one turn of a "
            )
            raise ScenarioError.of(f"{key}.lay_mm", message + "strand, or remove it and strands")
    lines = (
        [_line_of_points(table, key, ground_m, datum_m)]
        if table.path is None
        else _lines_of_file(table, key, ground_m, frame, window_m)
    )
    # A support reaches the highest wire.
    tops = [_parallels(table, line)[-1] if table.arrangement == "upright" else line for line in lines]
    supported = _supports(tops) if table.pylons != "none" else set()
    for number, line in enumerate(lines):
        name = key if table.path is None else f"{key}-{number}"
        conductors = []
        for parallel in _parallels(table, line):
            wire = Wire(
                vertex_m=parallel,
                radius_m=table.diameter_mm / 2000,
                sag_m=table.sag_m,
                strands=strands,
                reflectivity=reflectivity,
            )
            _check_clear(wire, f"{key}.{'points_m' if table.path is None else 'path'}", ground_m)
            conductors.append(wire)
        yield ThinObstacle(name=name, kind="wires", wires=tuple(conductors))
        for at, top_m in enumerate(tops[number]):
            if (number, at) not in supported:
                continue
            foot_m = float(_standing(top_m[None, :2], f"{key}.points_m", ground_m)[0])
            # A wire that is fixed to the ground needs none.
            if top_m[2] - foot_m > TOUCHING_M:
                yield _pylon(table, f"{name}-pylon-{at}", top_m, foot_m)


def _supports(lines: list[Line]) -> set[tuple[int, int]]:
    """Return the vertices under which a support stands, as numbers of line and vertex: the highest at each place.

    Lines of one file may meet, as power lines that are mapped in parts do, and a closed line ends where it begins.
    """
    highest: dict[tuple[float, ...], tuple[int, int]] = {}
    for number, line in enumerate(lines):
        for at, top_m in enumerate(line):
            other = highest.setdefault(tuple(np.round(top_m[:2], 2)), (number, at))  # to a centimetre
            if top_m[2] > lines[other[0]][other[1], 2]:
                highest[tuple(np.round(top_m[:2], 2))] = (number, at)
    return set(highest.values())


def _line_of_points(table: WireTable, key: str, ground_m: Heights, datum_m: float) -> Line:
    line = np.array(table.points_m, dtype=np.float64)
    if table.heights == "datum":
        line[:, 2] -= datum_m
        return line
    line[:, 2] += _standing(line[:, :2], f"{key}.points_m", ground_m)
    return line


def _lines_of_file(
    table: WireTable, key: str, ground_m: Heights, frame: MapFrame | None, window_m: Window
) -> list[Line]:
    assert table.path is not None
    attributes = [table.height] if table.height is not None else []
    query = VectorQuery(
        path=table.path, layer=table.layer, key=key, attributes=attributes, frame=frame, window_m=window_m
    )
    lines, name = read_lines(query), query.name
    height_m = np.full(len(lines.line), np.nan)
    if table.height is not None:
        height_m = np.array([height_of(value) for value in lines.values[table.height]], dtype=np.float64)
    if table.height_m is not None:
        height_m = np.where(np.isfinite(height_m), height_m, table.height_m)
    kept: list[Line] = []
    without = beyond = cut = 0
    for line, height in zip(lines.line, height_m, strict=True):
        ground = ground_m(line)
        # A line that leads off the terrain is kept as far as the last support that stands on it.
        on = np.flatnonzero(np.isfinite(ground))
        runs = [run for run in np.split(on, np.flatnonzero(np.diff(on) > 1) + 1) if len(run) > 1]
        if not height > 0:
            without += 1
        elif not runs:
            beyond += 1
        else:
            cut += len(on) < len(line)
            kept += [np.column_stack([line[run], ground[run] + height]) for run in runs]
    if without or beyond or cut or lines.dropped:
        logger.warning(
            "%s: left out %s lines without a height, %s beyond the terrain, and %s features that are no lines, of %s%s",
            name,
            f"{without:,}",
            f"{beyond:,}",
            f"{lines.dropped:,}",
            f"{len(lines.line) + lines.dropped:,}",
            f"; cut {cut:,} lines where they leave it" if cut else "",
        )
    if lines.raised:
        message = (
            "%s: the z coordinates of %s lines are not read; their height over the ground is that of height or height_m"
        )
        logger.warning(message, name, f"{lines.raised:,}")
    if len(lines.line) and not kept:
        raise InputFileError(f"{name}: none of its {len(lines.line):,} lines has a height and is over the terrain")
    if not kept:
        logger.warning("%s has no line near the survey: no wire is built of it", name)
    return kept


def _parallels(table: WireTable, line: Line) -> list[Line]:
    offset_m = (np.arange(table.count) - (table.count - 1) / 2) * (table.spacing_m or 0.0)
    if table.arrangement == "upright":
        return [line + np.array([0.0, 0.0, offset - offset_m[0]]) for offset in offset_m]
    return [offset_line(line, float(offset)) for offset in offset_m]


def _pylon(table: WireTable, name: str, top_m: Float[np.ndarray, " 3"], ground_m: float) -> ThinObstacle:
    foot, height_m = np.array([*top_m[:2], ground_m]), float(top_m[2]) - ground_m
    if table.pylons == "pole":
        radius_m = (table.pylon_width_m or POLE_M) / 2
        return ThinObstacle(name=name, kind="poles", wires=(Wire(vertex_m=np.array([foot, top_m]), radius_m=radius_m),))
    foot_width_m = table.pylon_width_m or MAST_FOOT * height_m
    members = lattice_mast(foot, height_m, foot_width_m, foot_width_m * MAST_TOP / MAST_FOOT)
    wires = tuple(Wire(vertex_m=member, radius_m=MEMBER_M / 2) for member in members)
    return ThinObstacle(name=name, kind="poles", wires=wires)


def _pole(table: PoleTable, key: str, scenario: Scenario, ground_m: Heights) -> ThinObstacle:
    foot = np.array([*table.position_m, table.base_m])
    foot[2] += _standing(foot[None, :2], f"{key}.position_m", ground_m)[0]
    lean, heading = np.deg2rad([table.tilt_deg, table.heading_deg])
    along = Rotation.from_euler("ZX", [-heading, -lean]).apply([0.0, 0.0, 1.0])
    match table.shape:
        case "lattice":
            base_m, top_m = table.width_m or (MAST_FOOT * table.length_m, MAST_TOP * table.length_m)
            parts = lattice_mast(foot, table.length_m, base_m, top_m)
        case "branch":
            parts = branch(foot, along, table.length_m)
        case _:
            parts = [np.array([foot, foot + table.length_m * along])]
    reflectivity = _reflectivity(table, key, scenario)
    wires = [Wire(vertex_m=part, radius_m=table.diameter_mm / 2000, reflectivity=reflectivity) for part in parts]
    for wire in wires:
        _check_clear(wire, f"{key}.tilt_deg", ground_m)
    return ThinObstacle(name=key, kind="poles", wires=tuple(wires))


def _fence(table: FenceTable, key: str, scenario: Scenario, ground_m: Heights) -> ThinObstacle:
    corner = np.array(table.points_m, dtype=np.float64)
    feet = [corner[:1]]
    spans = [int(np.ceil(np.linalg.norm(end - start) / table.post_spacing_m)) for start, end in pairwise(corner)]
    _check_cylinders(sum(spans) + 1 + table.wires, key)
    for start, end, count in zip(corner, corner[1:], spans, strict=False):
        feet.append(start + np.linspace(0, 1, count + 1)[1:, None] * (end - start))
    foot = np.concatenate(feet)
    foot = np.column_stack([foot, _standing(foot, f"{key}.points_m", ground_m)])
    up, reflectivity = np.array([0.0, 0.0, table.height_m]), _reflectivity(table, key, scenario)
    radius_m = table.post_diameter_mm / 2000
    wires = [Wire(vertex_m=np.array([f, f + up]), radius_m=radius_m, reflectivity=reflectivity) for f in foot]
    for number in range(table.wires):
        line = foot + up * (number + 1) / table.wires
        wires.append(Wire(vertex_m=line, radius_m=table.diameter_mm / 2000, reflectivity=reflectivity))
    return ThinObstacle(name=key, kind="fences", wires=tuple(wires))


def _standing(place_m: Float[np.ndarray, "n 2"], key: str, ground_m: Heights) -> Float[np.ndarray, " n"]:
    ground = ground_m(place_m)
    beyond = np.flatnonzero(~np.isfinite(ground))
    if len(beyond):
        x, y = place_m[beyond[0]]
        raise ScenarioError.of(key, f"({x:g}, {y:g}) is beyond the terrain; move it or enlarge the terrain")
    return ground


def _check_clear(wire: Wire, key: str, ground_m: Heights) -> None:
    """Raise ScenarioError for a wire that is under the ground anywhere, too high above it, or too long to look."""
    _check_length(_length_m(wire.vertex_m), key)
    point = wire.points(CHECKED_M)
    ground = ground_m(point[:, :2])
    above_m = np.nan_to_num(point[:, 2] - ground)
    highest = int(np.argmax(above_m))
    if above_m[highest] > HIGHEST_M:
        (x, y), high_m = point[highest, :2], above_m[highest]
        message = f"is {high_m:,.0f} m above the ground at ({x:.1f}, {y:.1f}), more than {HIGHEST_M:,.0f} m; lower it"
        raise ScenarioError.of(key, message)
    depth = np.where(np.isfinite(ground), ground - point[:, 2], -np.inf)
    deepest = int(np.argmax(depth))
    if depth[deepest] > INTO_GROUND_M:
        x, y = point[deepest, :2]
        remedy = "raise it, or lower sag_m" if wire.sag_m > 0 else "raise it"
        message = f"is {depth[deepest]:.1f} m under the ground at ({x:.1f}, {y:.1f}); {remedy}"
        raise ScenarioError.of(key, message)


def _warn_of_buildings(obstacle: ThinObstacle, caster: RayCaster) -> None:
    """Warn of wires that lead through a surface."""
    for wire in obstacle.wires:
        # Without its last part: it may end at a wall. Rays reach past their ends, as a face may be just there.
        point = wire.points(CHECKED_M)[:-1]
        blocked = np.flatnonzero(~caster.visible(point[:-1], point[1:], -TOUCHING_M))
        if len(blocked):
            x, y, z = point[blocked[0]]
            logger.warning("%s leads through a surface near (%.1f, %.1f, %.1f) m", obstacle.name, x, y, z)
            return
