"""What a survey saw of each obstacle: its echoes, how often and from how far, and what hid it.

A look is a pulse whose main beam meets an obstacle, or that hears of it through a side lobe. An echo carries the
identity of the obstacle whose paths are the strongest in its range cells.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.constants import speed_of_light

from sionna_radar.detection.echoes import Echoes
from sionna_radar.flight.pulses import Pulses
from sionna_radar.foundation.columns import Columns
from sionna_radar.mapping.points import Points
from sionna_radar.radar.antenna import Antenna, in_main_lobe
from sionna_radar.radar.chirp import Chirp
from sionna_radar.scene.build import World
from sionna_radar.scene.motion import Way
from sionna_radar.tracing.paths import FIRST_OBSTACLE, VEGETATION, VOLUME, Paths

# Echoes this many range cells from an obstacle's are within the main lobe of every window.
REACH_CELLS = 2
# An obstacle touches the ground, or another one: rays end this far before it, m.
TOUCHING_M = 0.1
# Points along an obstacle are looked for in the beam this many to its width.
POINTS_PER_BEAM = 3
# Names of surfaces that are obstacles, by the table of the scenario they come from.
TABLES = {"building": "buildings", "object": "objects", "footprints": "footprints"}


@dataclass(frozen=True, kw_only=True)
class Obstacle:
    """Something that stands in the scene, by its key in the scenario.

    kind: the table: "wires", "poles", "fences", "targets", "buildings", "objects", "footprints" or "vegetation".
    point_m: points along a thin one, or the place of a target at rest. way: of a target that moves. Both None for
        others, whose looks are their paths.
    """

    name: str
    kind: str
    point_m: Float[np.ndarray, "n 3"] | None = None
    way: Way | None = None


@dataclass(frozen=True, kw_only=True)
class Inventory:
    """The obstacles of a scene.

    of_surface: number of the obstacle that each surface belongs to; -1 for ground.
    first_stand: number of the first stand of plants.
    """

    obstacles: tuple[Obstacle, ...]
    of_surface: Int[np.ndarray, " surface"]
    first_stand: int
    world: World

    @classmethod
    def of(cls, world: World, spacing_m: float) -> "Inventory":
        """Return the obstacles of a world, thin ones with points about `spacing_m` apart."""
        scene = world.scene
        obstacles = [
            Obstacle(
                name=f"targets.{n}", kind="targets", point_m=None if t.way else np.array([t.position_m]), way=t.way
            )
            for n, t in enumerate(scene.targets)
        ]
        for thin in scene.thin:
            points = np.concatenate([wire.points(2 * spacing_m) for wire in thin.wires])
            obstacles.append(Obstacle(name=thin.name, kind=thin.kind, point_m=points))
        keys: dict[str, int] = {}
        of_surface = np.full(len(scene.surfaces), -1)
        for index, surface in enumerate(scene.surfaces):
            table, _, rest = surface.name.partition("-")
            if table not in TABLES:
                continue
            name = f"{TABLES[table]}.{rest.partition('-')[0]}"
            if name not in keys:
                keys[name] = len(obstacles)
                obstacles.append(Obstacle(name=name, kind=TABLES[table]))
            of_surface[index] = keys[name]
        first_stand = len(obstacles)
        stands = 0 if scene.vegetation is None else len(scene.vegetation.extinction_per_m)
        obstacles += [Obstacle(name=f"vegetation.{n}", kind="vegetation") for n in range(stands)]
        return cls(obstacles=tuple(obstacles), of_surface=of_surface, first_stand=first_stand, world=world)

    def numbers(self, paths: Paths) -> Int[np.ndarray, " path"]:
        """Return the number of the obstacle that each path comes from; -1 for ground and weather."""
        surface = paths.surface
        number = np.where(surface >= 0, self.of_surface[np.maximum(surface, 0)], -1)
        number = np.where(surface <= FIRST_OBSTACLE, FIRST_OBSTACLE - surface, number)
        plants = np.flatnonzero(surface == VEGETATION)
        if len(plants):
            cover = self.world.scene.vegetation
            assert cover is not None  # its paths are there
            row, column, inside = cover.grid.cell_of(paths.hit_m[plants])
            stand = np.where(inside, cover.stand[row, column], -1)
            number[plants] = np.where(stand >= 0, self.first_stand + stand, -1)
        return number


@dataclass(frozen=True, kw_only=True)
class Looks(Columns):
    """Looks at obstacles, one row each and one more for each further echo in a look, sorted by pulse.

    pulse, obstacle: index of the pulse, and number of the obstacle.
    range_m: of its strongest cell; of its nearest point in the beam where nothing comes back.
    place_m: where that echo comes from; time_s, speed_mps: of the pulse, the latter over the ground.
    power, clutter, rain: over the transmitted power: of the obstacle in that cell, coherently summed; the most in the
        cells around it from the ground and other obstacles; and from the weather.
    visible: whether anything of it in the beam was visible.
    in_beam: whether it is in the main beam, and not in a side lobe alone; false in the rows of further echoes.
    echo: number of the echo in its pulse that carries its identity; -1 for none.
    """

    pulse: Int[np.ndarray, " look"]
    obstacle: Int[np.ndarray, " look"]
    range_m: Float[np.ndarray, " look"]
    place_m: Float[np.ndarray, "look 3"]
    origin_m: Float[np.ndarray, "look 3"]
    time_s: Float[np.ndarray, " look"]
    speed_mps: Float[np.ndarray, " look"]
    power: Float[np.ndarray, " look"]
    clutter: Float[np.ndarray, " look"]
    rain: Float[np.ndarray, " look"]
    visible: Bool[np.ndarray, " look"]
    in_beam: Bool[np.ndarray, " look"]
    echo: Int[np.ndarray, " look"]


def looks_at(
    inventory: Inventory,
    pulses: Pulses,
    paths: Paths,
    echoes: Echoes,
    antennas: Sequence[Antenna],
    chirp: Chirp,
    shift_s: float,
) -> Looks:
    """Return the looks of a block of pulses, and a row more for each further echo of an obstacle in a pulse.

    paths: of the block. echoes: of the block, their ranges as read.
    antennas: one for each beam.
    chirp, shift_s: the sweep, and its shift of ranges per range rate; 0 for ranges without.
    """
    cells = _cells_of(inventory, pulses, paths, antennas, chirp, shift_s)
    pair = cells.row * len(inventory.obstacles) + cells.obstacle
    echo_row, cell = _owned(cells, pulses.row_of(echoes.pulse), echoes.range_m, chirp.range_resolution_m)
    echo = np.full(len(pair), -1)
    # Of several echoes from one cell the last is kept: they are one, of cells on either side.
    echo[cell] = echoes.number[echo_row]
    # A look is of the strongest cell with an echo, or else of the strongest cell.
    order = np.lexsort((-cells.power, echo < 0, pair))
    first = np.append(True, np.diff(pair[order]) > 0)[: len(order)]
    look, further = order[first], order[~first]
    further = further[echo[further] >= 0]
    in_beam = np.zeros(len(pair), dtype=bool)
    in_beam[look] = np.bincount(np.unique(pair, return_inverse=True)[1].ravel(), cells.in_beam) > 0
    rows = np.concatenate([look, further])
    heard = Looks(
        **_of_pulses(pulses, cells.row[rows]),
        obstacle=cells.obstacle[rows],
        range_m=cells.range_m[rows],
        place_m=cells.place_m[rows],
        power=cells.power[rows],
        clutter=cells.clutter[rows],
        rain=cells.rain[rows],
        visible=np.ones(len(rows), dtype=bool),
        in_beam=in_beam[rows],
        echo=echo[rows],
    )
    looks = Looks.concatenate([heard, _silent(inventory, pulses, antennas, chirp, pair[look])])
    return looks.rows(np.argsort(looks.pulse, kind="stable"))


@dataclass(frozen=True, kw_only=True)
class _Cells(Columns):
    """Range cells of pulses that obstacles return to, sorted by pulse, obstacle and cell; columns as of `Looks`.

    row: of the pulse in its block. read_m: range that is read of the echo, with its Doppler shift.
    outstanding: obstacles return more than the ground or the weather around.
    """

    row: Int[np.ndarray, " cell"]
    obstacle: Int[np.ndarray, " cell"]
    read_m: Float[np.ndarray, " cell"]
    range_m: Float[np.ndarray, " cell"]
    place_m: Float[np.ndarray, "cell 3"]
    power: Float[np.ndarray, " cell"]
    clutter: Float[np.ndarray, " cell"]
    rain: Float[np.ndarray, " cell"]
    outstanding: Bool[np.ndarray, " cell"]
    in_beam: Bool[np.ndarray, " cell"]


def _cells_of(
    inventory: Inventory, pulses: Pulses, paths: Paths, antennas: Sequence[Antenna], chirp: Chirp, shift_s: float
) -> _Cells:
    """Return the cells of obstacles, with the power of their coherent sums, and that of all else around them."""
    row, number = pulses.row_of(paths.pulse), inventory.numbers(paths)
    distance_m, read_m = paths.delay_s * (speed_of_light / 2), paths.read_m(shift_s)
    cell = np.floor(read_m / chirp.range_resolution_m).astype(np.int64)
    count, cells = len(inventory.obstacles), int(cell.max(initial=0)) + 2
    power = np.abs(paths.gain.astype(np.complex128)) ** 2
    own = np.flatnonzero(number >= 0)
    group, member = np.unique((row[own] * count + number[own]) * cells + cell[own], return_inverse=True)

    def total(values: Float[np.ndarray, " own"]) -> Float[np.ndarray, " group"]:
        return np.bincount(member.ravel(), values, len(group)).astype(np.float64)  # whole numbers without paths

    turn = np.mod(chirp.carrier_hz * paths.delay_s[own], 1.0)
    field = paths.gain[own] * np.exp(-2j * np.pi * turn)
    single = total(power[own])
    weight = power[own] / np.maximum(single, 1e-300)[member.ravel()]
    of_row, of_cell = group // cells // count, group % cells

    def around(chosen: Bool[np.ndarray, " path"]) -> Float[np.ndarray, "3 group"]:
        sums = np.bincount(row[chosen] * cells + cell[chosen], power[chosen], len(pulses) * cells)
        table = sums.astype(np.float64).reshape(-1, cells)
        return np.stack([table[of_row, np.clip(of_cell + k, 0, cells - 1)] for k in (-1, 0, 1)])

    rain, ground = around(paths.surface == VOLUME), around((paths.surface != VOLUME) & (number < 0))
    # Its own paths are no clutter of it.
    others = np.maximum(around(number >= 0) - [_at(group, single, group + k) for k in (-1, 0, 1)], 0.0)
    coherent = total(field.real) ** 2 + total(field.imag) ** 2
    return _Cells(
        row=of_row,
        obstacle=group // cells % count,
        read_m=total(weight * read_m[own]),
        range_m=total(weight * distance_m[own]),
        place_m=np.stack([total(weight * column) for column in paths.hit_m[own].T], axis=1),
        power=coherent,
        clutter=(ground + others).max(axis=0),
        rain=rain.max(axis=0),
        # The echo is that of all obstacles in the cell: several that are alike do not make it one of the ground.
        outstanding=coherent + others[1] >= np.maximum(ground, rain).max(axis=0),
        in_beam=total(_in_beam(pulses, row[own], paths.hit_m[own], antennas).astype(np.float64)) > 0,
    )


def _at(
    group: Int[np.ndarray, " group"], value: Float[np.ndarray, " group"], wanted: Int[np.ndarray, " n"]
) -> Float[np.ndarray, " n"]:
    """Return the values of groups by their keys, which increase; zero for keys that there are not."""
    at = np.minimum(np.searchsorted(group, wanted), max(len(group) - 1, 0))
    return np.where(group[at] == wanted, value[at], 0.0) if len(group) else np.zeros(len(wanted))


def _owned(
    cells: _Cells, row: Int[np.ndarray, " echo"], range_m: Float[np.ndarray, " echo"], cell_m: float
) -> tuple[Int[np.ndarray, " owned"], Int[np.ndarray, " owned"]]:
    """Return the echoes that are of an obstacle, and the cell of each: the strongest in reach."""
    # Pulses are laid end to end on one range axis.
    reach_m = REACH_CELLS * cell_m
    length_m = 4 * (max(cells.read_m.max(initial=0.0), range_m.max(initial=0.0)) + reach_m)
    strong = np.flatnonzero((cells.power > 0) & cells.outstanding)
    place = cells.row[strong] * length_m + cells.read_m[strong]
    strong, place = strong[np.argsort(place)], np.sort(place)
    at = row * length_m + range_m
    low, high = (np.searchsorted(place, at + side * reach_m) for side in (-1, 1))
    echo = np.repeat(np.arange(len(at)), high - low)
    cell = strong[np.arange(len(echo)) + np.repeat(low - np.cumsum(high - low) + (high - low), high - low)]
    order = np.lexsort((-cells.power[cell], echo))
    first = order[np.append(True, np.diff(echo[order]) > 0)[: len(order)]]
    return echo[first], cell[first]


def _of_pulses(pulses: Pulses, row: Int[np.ndarray, " n"]) -> dict[str, np.ndarray]:
    return {
        "pulse": pulses.index[row],
        "origin_m": pulses.true.position_m[row],
        "time_s": pulses.time_s[row],
        "speed_mps": np.hypot(*pulses.true.velocity_mps[row, :2].T),
    }


def _in_beam(
    pulses: Pulses, row: Int[np.ndarray, " n"], place_m: Float[np.ndarray, "n 3"], antennas: Sequence[Antenna]
) -> Bool[np.ndarray, " n"]:
    away = place_m - pulses.true.position_m[row]
    direction = np.einsum("nij,ni->nj", pulses.true.R_world_antenna[row], away)
    direction /= np.maximum(np.linalg.norm(direction, axis=1), 1e-9)[:, None]
    beam = np.zeros(len(pulses), dtype=np.int64) if pulses.beam is None else pulses.beam
    inside = np.zeros(len(row), dtype=bool)
    for number in np.unique(beam):
        some = np.flatnonzero(beam[row] == number)
        inside[some] = in_main_lobe(antennas[int(number) % len(antennas)], direction[some])
    return inside


def _silent(
    inventory: Inventory, pulses: Pulses, antennas: Sequence[Antenna], chirp: Chirp, heard: Int[np.ndarray, " pair"]
) -> Looks:
    """Return the looks at thin obstacles and points in the main beam of which no path came back."""
    position, count = pulses.true.position_m, len(inventory.obstacles)
    centre = (position.min(axis=0) + position.max(axis=0)) / 2
    around_m = np.linalg.norm(position - centre, axis=1).max() + chirp.max_range_m
    parts = [no_looks()]
    for number, obstacle in enumerate(inventory.obstacles):
        if obstacle.way is not None:
            row, place = np.arange(len(pulses)), obstacle.way.at(pulses.time_s)[0]
        elif obstacle.point_m is not None:
            point = obstacle.point_m[np.linalg.norm(obstacle.point_m - centre, axis=1) < around_m]
            row = np.repeat(np.arange(len(pulses)), len(point))
            place = np.tile(point, (len(pulses), 1))
        else:
            continue
        lit = np.flatnonzero(_in_beam(pulses, row, place, antennas))
        range_m = np.linalg.norm(place[lit] - position[row[lit]], axis=1)
        lit, range_m = lit[range_m < chirp.max_range_m], range_m[range_m < chirp.max_range_m]
        new = ~np.isin(row[lit] * count + number, heard)
        lit, range_m = lit[new], range_m[new]
        if len(lit) == 0:
            continue
        visible = inventory.world.caster.visible(position[row[lit]], place[lit], TOUCHING_M)
        order = np.lexsort((range_m, row[lit]))
        first = order[np.append(True, np.diff(row[lit][order]) > 0)]
        any_visible = np.bincount(row[lit], visible, len(pulses))[row[lit][first]] > 0
        zero = np.zeros(len(first))
        parts.append(
            Looks(
                **_of_pulses(pulses, row[lit][first]),
                obstacle=np.full(len(first), number),
                range_m=range_m[first],
                place_m=place[lit][first],
                power=zero,
                clutter=zero,
                rain=zero,
                visible=any_visible,
                in_beam=np.ones(len(first), dtype=bool),
                echo=np.full(len(first), -1),
            )
        )
    return Looks.concatenate(parts)


def no_looks() -> Looks:
    """Return no looks."""
    whole, real, three, mask = np.zeros(0, np.int64), np.zeros(0), np.zeros((0, 3)), np.zeros(0, bool)
    return Looks(
        pulse=whole, obstacle=whole, range_m=real, place_m=three, origin_m=three, time_s=real, speed_mps=real,
        power=real, clutter=real, rain=real, visible=mask, in_beam=mask, echo=whole,
    )  # fmt: skip


def _rows_of(points: Points, looks: Looks) -> Int[np.ndarray, " look"]:
    """Return the row of the point that each look's echo became."""
    step = int(points.number.max(initial=0)) + 1
    key = points.pulse * step + points.number
    order = np.argsort(key)
    return order[np.searchsorted(key[order], looks.pulse * step + looks.echo)]


def identities(looks: Looks, points: Points) -> Int[np.ndarray, " point"]:
    """Return the number of the obstacle that each point is of; -1 for ground, weather and noise."""
    identity = np.full(len(points), -1)
    heard = looks.rows(looks.echo >= 0)
    identity[_rows_of(points, heard)] = heard.obstacle
    return identity


@dataclass(frozen=True, kw_only=True)
class SeenObstacle:
    """What a survey saw of an obstacle.

    looks: pulses whose main beam met it; visible: those that the ground or a building did not hide it from.
    echoes: of it, in the main beam or not; pd_look: share of the visible looks with an echo, NaN without any.
    first_s, first_range_m: time and range of the first echo; warning_s: from then to where it is, at the speed over
        the ground at that time; NaN without an echo.
    report_warning_s: the same from the pulse with which the processing reports it; NaN if it does not.
    height_error_m, position_error_m: of its points: mean height over where the echoes come from, and RMS distance from
        there.
    hidden_by: what hid it where it was never heard: "beam", "shadow", "noise", "ground clutter", "rain" or
        "another echo"; "" if seen.
    """

    name: str
    kind: str
    looks: int
    visible: int
    echoes: int
    pd_look: float
    first_s: float
    first_range_m: float
    warning_s: float
    report_warning_s: float
    height_error_m: float
    position_error_m: float
    hidden_by: str

    @property
    def seen(self) -> bool:
        """Whether any echo is of it."""
        return self.echoes > 0


def seen_obstacles(
    obstacles: Sequence[Obstacle], looks: Looks, points: Points, least_power: float, reports: Mapping[int, int]
) -> tuple[SeenObstacle, ...]:
    """Return the looks, echoes, detection probability, warning time and position error of each obstacle.

    points: of the survey. least_power: detection threshold in noise, over the transmitted power.
    reports: the pulse with which each obstacle was reported, by its number.
    """
    seen = []
    for number, obstacle in enumerate(obstacles):
        own = looks.rows(looks.obstacle == number)
        heard = own.rows(own.echo >= 0)
        at = _rows_of(points, heard)
        offset = points.position_m[at] - heard.place_m if len(heard) else np.full((1, 3), np.nan)
        lit = own.rows(own.in_beam)
        open_looks = int(np.count_nonzero(lit.visible))
        first = int(np.argmin(heard.time_s)) if len(heard) else -1
        known = heard.rows(heard.pulse >= reports[number]) if number in reports else heard.rows(slice(0))
        seen.append(
            SeenObstacle(
                name=obstacle.name,
                kind=obstacle.kind,
                looks=len(lit),
                visible=open_looks,
                echoes=len(heard),
                pd_look=float(np.count_nonzero(lit.echo >= 0) / open_looks) if open_looks else float("nan"),
                first_s=float(heard.time_s[first]) if len(heard) else float("nan"),
                first_range_m=float(heard.range_m[first]) if len(heard) else float("nan"),
                warning_s=_time_to_reach_s(heard),
                report_warning_s=_time_to_reach_s(known),
                height_error_m=float(offset[:, 2].mean()),
                position_error_m=float(np.sqrt(np.mean(np.sum(offset**2, axis=1)))),
                hidden_by="" if len(heard) else _hidden_by(own, least_power),
            )
        )
    return tuple(seen)


def _time_to_reach_s(looks: Looks) -> float:
    """Return the time from the first look to where its echo comes from, at the speed over the ground; NaN for none."""
    if len(looks) == 0:
        return float("nan")
    first = int(np.argmin(looks.time_s))
    level_m = np.hypot(*(looks.place_m[first] - looks.origin_m[first])[:2])
    return float(level_m / max(looks.speed_mps[first], 1e-9))


def _hidden_by(looks: Looks, least_power: float) -> str:
    """Return the cause of most missed looks at an obstacle, as `SeenObstacle.hidden_by` has it."""
    lit = looks.rows(looks.in_beam)
    if len(lit) == 0:
        return "beam"
    open_looks = lit.rows(lit.visible)
    if 2 * len(open_looks) <= len(lit):
        return "shadow"
    against = np.stack([np.full(len(open_looks), least_power), open_looks.clutter, open_looks.rain])
    # Stronger than all of that in its cells, it went down in the longer echo of something else.
    worst = np.where(open_looks.power > against.max(axis=0), 3, np.argmax(against, axis=0))
    return ("noise", "ground clutter", "rain", "another echo")[int(np.argmax(np.bincount(worst, minlength=4)))]
