"""Named quantities of a radar and its flight in closed form, expressions over them, requirements, and costs.

Quantities cost nothing to compute, and stand beside the errors of a survey in requirements, objectives, costs and
tables. All are those of level ground `platform.altitude_m` under the flight. The scan and the antenna decide which are
defined; an undefined one is NaN.

An expression is arithmetic (`+ - * / **`, parentheses) with `abs`, `exp`, `log`, `log10`, `max`, `min`, `sqrt` over
numbers and names such as `rms_m` or `radar.antenna.beamwidth_deg`. It is parsed, never executed as Python: whatever is
not listed here is refused.
"""

import ast
import csv
import io
import math
import operator
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import combinations, product
from pathlib import Path
from typing import Any, NoReturn, TypeGuard

import numpy as np
from jaxtyping import Float
from scipy.constants import speed_of_light

from sionna_radar.flight.build import plan_route
from sionna_radar.flight.covering_lines import covering_lines
from sionna_radar.foundation.errors import InputFileError, RadarError
from sionna_radar.foundation.input_file import parse_toml, read_text, shown
from sionna_radar.foundation.numerics import is_number
from sionna_radar.radar.build import build_antenna
from sionna_radar.scenario import ScanParameters, Scenario
from sionna_radar.scenario.overrides import value_at
from sionna_radar.scenario.problems import nearest
from sionna_radar.scenario.radar import AntennaTable, ArrayAntennaTable, ElectronicScanTable, ScanTable
from sionna_radar.scenario.receiver import ArrayTable
from sionna_radar.scenario.reference import dotted_keys
from sionna_radar.studies.sweep.settings import refuse

NAN = float("nan")
# Bits of a sample without `radar.receiver.converter.bits`: the word in which samples are stored.
STORED_BITS = 16


@dataclass(frozen=True, kw_only=True)
class Area:
    """An area to be mapped: its sides, and the share of a swath that the next line covers again."""

    size_m: tuple[float, float]
    overlap: float = 0.2


@dataclass(frozen=True, kw_only=True)
class Quantity:
    """A named quantity: its unit, its formula, and its value for a scenario and an area (None: the scenario's flight).

    undefined: when it is NaN.
    """

    unit: str
    formula: str
    value: Callable[[Scenario, Area | None], float]
    undefined: str = ""


def quantities_of(scenario: Scenario, area: Area | None = None, names: Iterable[str] | None = None) -> dict[str, float]:
    """Return some or all of `QUANTITIES` by name; NaN where the scenario leaves one undefined."""
    return {name: QUANTITIES[name].value(scenario, area) for name in (QUANTITIES if names is None else names)}


def key_value(scenario: Scenario, key: str) -> float:
    """Return the number under a dotted key; raises ScenarioError for anything but a number."""
    if not is_number(value := value_at(scenario, key)):
        refuse(f"{value!r} is no number here, and cannot be part of an expression", key)
    return float(value)


def taylor_aperture_m(beamwidth_rad: float, side_lobe_db: float, wavelength_m: float) -> float:
    """Return the length of a line source with a Taylor taper for a half-power beamwidth.

    HPBW = 2 asin(sigma wavelength / (pi L) sqrt(acosh(R)^2 - acosh(R / sqrt 2)^2)) with the voltage ratio R of main to
    side lobe, A = acosh(R) / pi, nbar >= 2 A^2 + 1/2 and sigma = nbar / sqrt(A^2 + (nbar - 1/2)^2) (Taylor 1955,
    "Design of line-source antennas for narrow beamwidth and low side lobes").
    """
    ratio = 10 ** (-side_lobe_db / 20)
    a = math.acosh(ratio) / math.pi
    nbar = max(2, math.ceil(2 * a**2 + 0.5))
    sigma = nbar / math.hypot(a, nbar - 0.5)
    width = math.sqrt(math.acosh(ratio) ** 2 - math.acosh(ratio / math.sqrt(2)) ** 2)
    return sigma * wavelength_m * width / (math.pi * math.sin(beamwidth_rad / 2))


def _array(scenario: Scenario) -> ArrayTable | None:
    """Return the array of a module that maps without turning; None for other sensors."""
    return scenario.radar.array if scenario.sensor == "mimo" else None


def _aperture_m(scenario: Scenario, _area: Area | None = None) -> float:
    antenna, wavelength = scenario.radar.antenna, speed_of_light / scenario.radar.carrier_hz
    if scenario.sensor == "lidar":
        return NAN
    if (array := _array(scenario)) is not None:
        places = np.array([*array.transmitters_wavelengths, *array.receivers_wavelengths])
        return float(np.ptp(places, axis=0).max()) * wavelength
    if isinstance(antenna, AntennaTable):
        return taylor_aperture_m(min(antenna.beamwidths_rad), antenna.side_lobe_db, wavelength)
    if isinstance(antenna, ArrayAntennaTable) and antenna.elements is not None:
        spacing = antenna.spacing_wavelengths
        spacings = spacing if isinstance(spacing, tuple) else (spacing, spacing)
        return max(n * d for n, d in zip(antenna.elements, spacings, strict=True)) * wavelength
    return NAN


def _beamwidths_rad(scenario: Scenario) -> tuple[float, float]:
    """Return the half-power beamwidths in azimuth and elevation; of an array its whole view, NaN of a lidar."""
    antenna = scenario.radar.antenna
    if scenario.sensor == "lidar":
        return NAN, NAN
    if (array := _array(scenario)) is not None:
        return 2 * math.radians(array.half_view_deg), 2 * math.radians(array.half_view_deg)
    if isinstance(antenna, AntennaTable):
        return antenna.beamwidths_rad
    try:
        return build_antenna(antenna).beamwidths_rad
    except RadarError:
        return NAN, NAN


def _duty(scenario: Scenario) -> float:
    """Return the share of time in which the radar transmits."""
    radar, array = scenario.radar, _array(scenario)
    if array is not None:
        return array.chirps_per_frame * array.frame_rate_hz / radar.chirp_rate_hz
    return radar.scan.half_swath_deg / 180 if _turns(radar.scan) else 1.0


def _turns(scan: ScanParameters) -> TypeGuard[ScanTable]:
    return isinstance(scan, ScanTable) and scan.mode in ("whisk_broom", "conical")


def _pulses_per_s(scenario: Scenario, _area: Area | None = None) -> float:
    return scenario.radar.mean_rate_hz * (2 if scenario.radar.sweep == "triangular" else 1) * _duty(scenario)


def _samples_per_s(scenario: Scenario, _area: Area | None = None) -> float:
    radar = scenario.radar
    parts = 2 if radar.sampling == "iq" else 1
    table = radar.second_receiver
    receivers = 1 if table is None else table.receivers or 2
    if (array := _array(scenario)) is not None:
        receivers = len(array.receivers_wavelengths)
    if scenario.sensor == "lidar":
        return NAN
    return _pulses_per_s(scenario) * radar.samples_per_chirp * parts * receivers


def _transmit_power_w(scenario: Scenario, _area: Area | None = None) -> float:
    power_dbm, array = scenario.radar.transmit_power_dbm, _array(scenario)
    if power_dbm is None or scenario.sensor == "lidar":
        return NAN
    at_once = 1 if array is None or array.multiplexing == "tdm" else len(array.transmitters_wavelengths)
    return 10 ** ((power_dbm - 30) / 10) * at_once * _duty(scenario)


def _flight(scenario: Scenario) -> tuple[float, float]:
    """Return height and speed of a planned flight; NaN for a log."""
    platform = scenario.platform
    if platform.altitude_m is None or platform.speed_mps is None:
        return NAN, NAN
    return platform.altitude_m, platform.speed_mps


def _swath_m(scenario: Scenario, _area: Area | None = None) -> float:
    scan, (height, _) = scenario.radar.scan, _flight(scenario)
    if not isinstance(scan, ScanTable | ElectronicScanTable):
        return NAN
    incidence, half = math.radians(scan.incidence_deg), math.radians(scan.half_swath_deg)
    azimuth, elevation = _beamwidths_rad(scenario)
    if _looks_aside(scan):
        # An array's beams to a side follow each other along the track: across it they are one beam wide.
        near, far = incidence - elevation / 2, incidence + elevation / 2
        return height * (math.tan(far) - math.tan(near)) if far < math.pi / 2 else NAN
    if scan.mode == "whisk_broom":
        return 2 * height * math.tan(half)
    if scan.mode == "conical":
        return 2 * height * math.tan(incidence) * math.sin(min(half, math.pi / 2)) or NAN
    side = half if scan.mode == "electronic" else azimuth / 2
    return 2 * height / math.cos(incidence) * math.tan(side)


def _looks_aside(scan: ScanParameters) -> bool:
    """Return True if the beam looks to a side of the track in the middle of the scan."""
    return scan.look != "forward" if isinstance(scan, ElectronicScanTable) else scan.mode == "side_looking"


def _line_gap_m(scenario: Scenario, _area: Area | None = None) -> float:
    scan, (_, speed) = scenario.radar.scan, _flight(scenario)
    if isinstance(scan, ElectronicScanTable):
        return speed / scan.scans_per_s
    if not isinstance(scan, ScanTable):
        return NAN
    if (array := _array(scenario)) is not None:
        return speed / array.frame_rate_hz
    return speed * 60 / scan.rotation_rpm if _turns(scan) else speed / scenario.radar.mean_rate_hz


def _dwell_s(scenario: Scenario, _area: Area | None = None) -> float:
    scan, (height, speed) = scenario.radar.scan, _flight(scenario)
    if isinstance(scan, ElectronicScanTable):
        return 1 / (scan.beams * scan.scans_per_s)
    if not isinstance(scan, ScanTable):
        return NAN
    if (array := _array(scenario)) is not None:
        return array.chirps_per_frame / scenario.radar.chirp_rate_hz
    azimuth, elevation = _beamwidths_rad(scenario)
    incidence = math.radians(scan.incidence_deg)
    if _turns(scan):
        arm = math.cos(incidence) if scan.mode == "whisk_broom" else math.sin(incidence)
        return azimuth / (2 * math.pi * scan.rotation_rpm / 60 * arm) if arm > 0 else NAN
    slant = height / math.cos(incidence)
    along = slant * azimuth if scan.mode == "side_looking" else slant / math.cos(incidence) * elevation
    return along / speed


def _covering(scenario: Scenario, area: Area | None) -> tuple[float, float]:
    """Return the number of lines and the time over an area, else of the scenario's own cruise; NaN for a log."""
    platform, (height, speed) = scenario.platform, _flight(scenario)
    if area is not None:
        swath, scan = _swath_m(scenario), scenario.radar.scan
        if not swath > 0:
            return NAN, NAN
        incidence = 0.0 if _looks_aside(scan) else math.radians(getattr(scan, "incidence_deg", 0.0))
        half_swath = math.atan(swath / (2 * height))
        track = covering_lines(area.size_m, _line_gap_m(scenario), height, incidence, half_swath, area.overlap)
        return float(track.count), track.length_m / speed
    if platform.log is not None:
        return NAN, NAN
    lines = max(len(platform.waypoints_m) - 1, 1)
    if platform.lines is not None:
        lines = platform.lines.count * (2 if platform.lines.crossing else 1)
    try:
        return float(lines), plan_route(platform, lambda: None).duration_s
    except RadarError:
        return NAN, NAN


LOG = "of a flight log, which has no altitude_m and speed_mps"
SWATH = f"{LOG}; of scans of your own, a conical one at incidence 0, and of beams that reach the horizon"
LIDAR = "of a lidar"
QUANTITIES: dict[str, Quantity] = {
    "aperture_m": Quantity(
        unit="m",
        formula="longer side of the antenna: a Taylor line source of the narrower beamwidth; elements times spacing; "
        "or of the box around all elements of radar.array",
        value=_aperture_m,
        undefined=f"{LIDAR}, and of an antenna that is neither taylor nor an array given by its elements",
    ),
    "pulses_per_s": Quantity(
        unit="1/s",
        formula="sweeps a second, times the share of a turn in which the radar transmits (half_swath_deg / 180); of "
        "radar.array the chirps of its frames",
        value=_pulses_per_s,
    ),
    "samples_per_s": Quantity(
        unit="1/s",
        formula="pulses_per_s x samples_per_chirp x 2 for I/Q x receivers",
        value=_samples_per_s,
        undefined=LIDAR,
    ),
    "data_rate_mbps": Quantity(
        unit="Mbit/s",
        formula=f"samples_per_s x converter.bits ({STORED_BITS} without) / 10^6: the raw samples, averaged over a turn",
        value=lambda scenario, _: (
            1e-6 * (scenario.radar.receiver.converter.bits or STORED_BITS) * _samples_per_s(scenario)
        ),
        undefined=LIDAR,
    ),
    "transmit_power_w": Quantity(
        unit="W",
        formula="10^((transmit_power_dbm - 30) / 10) x the share of a turn (of radar.array: of the time) in which the "
        "radar transmits x transmitters at once",
        value=_transmit_power_w,
        undefined=f"{LIDAR}, and with radar.snr_db, which says nothing of power; give radar.transmit_power_dbm and "
        "noise_figure_db",
    ),
    "swath_m": Quantity(
        unit="m",
        formula="whisk_broom 2 h tan(half swath); conical 2 h tan(incidence) sin(half swath); electronic 2 h "
        "tan(half swath) / cos(incidence), or to a side, and fixed and side_looking: the half-power footprint across "
        "the track; of radar.array that of its view, half_view_deg",
        value=_swath_m,
        undefined=SWATH,
    ),
    "area_per_hour_km2": Quantity(
        unit="km2/h",
        formula="swath_m x speed x 3600 s, along one line and without overlap",
        value=lambda scenario, _: 3600e-6 * _swath_m(scenario) * _flight(scenario)[1],
        undefined=SWATH,
    ),
    "lines": Quantity(
        unit="1",
        formula="flight lines over --area, side / (swath_m (1 - overlap)), as `plan` lays them; or of the own flight",
        value=lambda scenario, area: _covering(scenario, area)[0],
        undefined=SWATH,
    ),
    "flying_time_s": Quantity(
        unit="s",
        formula="length of the lines over --area and of the ways between them / speed; or of the scenario's own cruise",
        value=lambda scenario, area: _covering(scenario, area)[1],
        undefined=SWATH,
    ),
    "line_gap_m": Quantity(
        unit="m",
        formula="way flown from one scan line to the next: speed x 60 / rotation_rpm, or over scans, frames or chirps "
        "a second",
        value=_line_gap_m,
        undefined=f"{LOG}; of scans of your own",
    ),
    "dwell_s": Quantity(
        unit="s",
        formula="time in which the beam moves by its half-power width: azimuth width / (2 pi rpm / 60 cos(incidence)) "
        "of whisk_broom, sin of conical; fixed and side_looking: footprint / speed; electronic: one beam's "
        "time; radar.array: a frame's chirps",
        value=_dwell_s,
        undefined=f"{LOG}; {LIDAR}; of scans of your own",
    ),
}


LONGEST = 500
BINARY: dict[type[ast.operator], Callable[[Any, Any], Any]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.Pow: operator.pow,
}
FUNCTIONS: dict[str, Callable[..., Any]] = {
    "abs": np.abs,
    "exp": np.exp,
    "log": np.log,
    "log10": np.log10,
    "max": lambda *values: np.maximum.reduce(np.broadcast_arrays(*values)),
    "min": lambda *values: np.minimum.reduce(np.broadcast_arrays(*values)),
    "sqrt": np.sqrt,
}
# Option of the conditions.
REQUIRE = "--require"
COMPARED = {ast.Lt: "<", ast.LtE: "<=", ast.Gt: ">", ast.GtE: ">="}
# Values by name: numbers, or arrays of one shape.
Values = Mapping[str, Any]


@dataclass(frozen=True)
class Expression:
    """A parsed expression; equal to another one of the same text."""

    text: str
    tree: ast.expr = field(repr=False, compare=False)

    @property
    def names(self) -> tuple[str, ...]:
        """The names that it depends on, each once."""
        return tuple(dict.fromkeys(_names(self.tree)))

    def value(self, values: Values) -> Float[np.ndarray, "..."]:
        """Return its value; NaN or infinite where it is undefined, such as the logarithm of a negative number."""
        with np.errstate(all="ignore"):
            return np.asarray(_value(self.tree, values), dtype=float)


@dataclass(frozen=True)
class Requirement:
    """A condition LEFT < RIGHT; `a > b` is stored as b < a."""

    text: str
    left: Expression
    right: Expression

    @property
    def names(self) -> tuple[str, ...]:
        """The names that it depends on, each once."""
        return tuple(dict.fromkeys((*self.left.names, *self.right.names)))

    def margin(self, values: Values, relaxed: float = 0.0) -> Float[np.ndarray, "..."]:
        """Return the margin of the condition, positive if it holds; NaN where it is undefined.

        relaxed: share by which the limit, a side without errors of a survey or else the right one, gives way.
        """
        left, right = self.left.value(values), self.right.value(values)
        limit = left if not self.left.names else right
        return np.asarray(right - left + relaxed * np.abs(limit))


def parse_expression(text: str, option: str) -> Expression:
    """Return an expression; raises ScenarioError, with the option or field that holds it, for anything else."""
    tree = _parsed(text, option)
    _check(tree, text, option)
    return Expression(text=" ".join(text.split()), tree=tree)


def parse_requirement(text: str) -> Requirement:
    """Return a condition such as `rms_m < 0.10`; raises ScenarioError for anything else."""
    tree = _parsed(text, REQUIRE)
    if not isinstance(tree, ast.Compare) or len(tree.ops) != 1 or type(tree.ops[0]) not in COMPARED:
        refuse(f"{shown(text)} is no condition; give one such as 'rms_m < 0.10' or 'coverage > 0.9'", REQUIRE)
    sides = []
    for side in (tree.left, tree.comparators[0]):
        _check(side, text, REQUIRE)
        sides.append(Expression(text=ast.unparse(side), tree=side))
    if not (sides[0].names or sides[1].names):
        refuse(f"{shown(text)} names nothing that a design changes; give one such as 'rms_m < 0.10'", REQUIRE)
    if type(tree.ops[0]) in (ast.Gt, ast.GtE):
        sides.reverse()
    return Requirement(" ".join(text.split()), *sides)


# Bounds of results of a survey that hold whatever is flown.
BOUNDS = {
    **dict.fromkeys(("rms_m", "std_m", "nmad_m", "le90_m", "off_wall_rms_m", "all_cells_rms_m"), (0.0, np.inf)),
    **dict.fromkeys(("stated_sigma_m", "common_rms_m", "mapped_m2", "mapped_swath_m"), (0.0, np.inf)),
    **dict.fromkeys(("coverage", "coverage_of_swath", "pd_wire", "pd_obstacle"), (0.0, 1.0)),
    **dict.fromkeys(("warning_s", "false_alarms_per_km2", "false_alarms_per_minute"), (0.0, np.inf)),
}


def check_consistent(requirements: Sequence[Requirement]) -> None:
    """Raise ScenarioError, with the conditions, for requirements that no setting can meet together."""
    for count in (1, 2, len(requirements)):
        for chosen in combinations(requirements, min(count, len(requirements))):
            if not _possible(chosen):
                texts = " and ".join(shown(requirement.text) for requirement in chosen)
                if len(chosen) == 1:
                    refuse(f"{texts} can never hold; a result lies strictly within its bounds", REQUIRE)
                refuse(f"{texts} contradict each other; change or remove one", REQUIRE)


def _possible(requirements: Sequence[Requirement]) -> bool:
    """Return False if the requirements contradict each other, each side taken as one unknown, or as its number.

    Conditions x < y + c are edges of a graph; they contradict each other if it has a cycle whose sum is not positive
    (Cormen et al. 2009, "Introduction to algorithms", sec. 24.4). Bounds of results may be reached.
    """
    sides = {side.text: side for requirement in requirements for side in (requirement.left, requirement.right)}
    unknown = [text for text, side in sides.items() if side.names]
    node = {text: number for number, text in enumerate(unknown, 1)}
    offset = {text: 0.0 if side.names else float(side.value({})) for text, side in sides.items()}
    # least[x, y]: least c known of x - y <= c; node 0 is the number 0.
    least = np.full((len(unknown) + 1,) * 2, np.inf)
    strict = np.zeros(least.shape, dtype=bool)
    for text in unknown:
        low, high = BOUNDS.get(text, (-np.inf, np.inf))
        least[0, node[text]], least[node[text], 0] = -low, high
    for requirement in requirements:
        left, right = requirement.left.text, requirement.right.text
        x, y, c = node.get(left, 0), node.get(right, 0), offset[right] - offset[left]
        if c <= least[x, y]:
            least[x, y], strict[x, y] = c, True
    for k in range(len(least)):
        for x, y in product(range(len(least)), repeat=2):
            through = least[x, k] + least[k, y]
            if through < least[x, y]:
                least[x, y], strict[x, y] = through, strict[x, k] | strict[k, y]
            elif through == least[x, y]:
                strict[x, y] |= strict[x, k] | strict[k, y]
    own = np.diagonal(least)
    return not bool(((own < 0) | ((own == 0) & np.diagonal(strict))).any())


def check_names(names: Sequence[str], known: Sequence[str], option: str) -> None:
    """Raise ScenarioError, with the nearest name, for a name that is neither known nor a key of a scenario."""
    others = [name for name in names if name not in known]
    keys = dotted_keys() if others else []  # a third of a second
    for name in others:
        if name not in keys:
            message = f"{name} is no key of a scenario and no named quantity.{nearest(name, [*known, *keys])}"
            refuse(f"{message} `sionna-radar design --help` lists them; --costs adds yours, as mass_kg", option)


def _parsed(text: str, option: str) -> ast.expr:
    if len(text) > LONGEST:
        refuse(f"{len(text):,} characters are more than {LONGEST}; shorten the expression", option)
    try:
        return ast.parse(text.strip(), mode="eval").body
    except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
        refuse(f"{shown(text)} is no expression ({getattr(error, 'msg', error)}); write as in 'rms_m < 0.10'", option)


def _check(node: ast.expr, text: str, option: str) -> None:
    """Refuse all but the arithmetic of this module."""
    match node:
        case ast.BinOp(left=left, op=op, right=right) if type(op) in BINARY:
            _check(left, text, option)
            _check(right, text, option)
        case ast.UnaryOp(op=ast.USub() | ast.UAdd(), operand=inner):
            _check(inner, text, option)
        case ast.Constant(value=bool()):
            refuse(f"{shown(text)}: {ast.unparse(node)} is no number", option)
        case ast.Constant(value=int() | float() as number):
            if not abs(number) <= sys.float_info.max:
                refuse(f"{shown(text)}: {shown(ast.unparse(node))} is too large; give at most 1e308", option)
        case ast.Name():
            return
        case ast.Attribute() if _dotted(node) is not None:
            return
        case ast.Call(func=ast.Name(id=name), args=[_, *_] as args, keywords=[]) if name in FUNCTIONS:
            if name not in ("max", "min") and len(args) != 1:
                refuse(f"{shown(text)}: {name} takes one value", option)
            for inner in args:
                _check(inner, text, option)
        case _:
            allowed = f"numbers, names, + - * / ** and {', '.join(FUNCTIONS)}"
            refuse(f"{shown(text)}: {shown(ast.unparse(node))} is not allowed; use {allowed}", option)


def _dotted(node: ast.expr) -> str | None:
    """Return the dotted name of a node; None if it is no name."""
    if isinstance(node, ast.Attribute):
        head = _dotted(node.value)
        return None if head is None else f"{head}.{node.attr}"
    return node.id if isinstance(node, ast.Name) else None


def _names(node: ast.AST) -> Iterator[str]:
    if isinstance(node, ast.expr) and (name := _dotted(node)) is not None:
        yield name
    elif isinstance(node, ast.Call):
        for inner in node.args:
            yield from _names(inner)
    else:
        for child in ast.iter_child_nodes(node):
            yield from _names(child)


def _value(node: ast.expr, values: Values) -> Any:
    name = _dotted(node)
    if name is not None:
        return np.asarray(values[name], dtype=float)
    match node:
        case ast.BinOp(left=left, op=op, right=right):
            return BINARY[type(op)](_value(left, values), _value(right, values))
        case ast.UnaryOp(op=op, operand=inner):
            return -_value(inner, values) if isinstance(op, ast.USub) else _value(inner, values)
        case ast.Call(func=ast.Name(id=function), args=args):
            return FUNCTIONS[function](*(_value(inner, values) for inner in args))
        case ast.Constant(value=int() | float() as number):
            return np.float64(number)
    raise AssertionError(node)  # checked when it was parsed


@dataclass(frozen=True)
class Costs:
    """Costs by component, such as mass_kg and price_eur: each a number, or an expression.

    components: expressions by cost, by component.
    """

    components: Mapping[str, Mapping[str, Expression]] = field(default_factory=dict)

    @staticmethod
    def of(tables: Mapping[str, Any], source: str = "costs") -> "Costs":
        """Return the costs of tables by component, each value a number or the text of an expression.

        Raises InputFileError for anything else, and ScenarioError for a wrong expression.
        """
        components: dict[str, dict[str, Expression]] = {}
        for component, table in tables.items():
            if not isinstance(table, dict) or not table:
                _no_costs(source, f"{component} is no table of costs")
            for name, value in table.items():
                if not name.isidentifier():
                    _no_costs(source, f"{shown(name)} is no name of a cost")
                if isinstance(value, bool) or not isinstance(value, int | float | str):
                    _no_costs(source, f"{component}.{name} = {shown(str(value))} is neither a number nor an expression")
                expression = parse_expression(str(value), f"{source}, {component}.{name}")
                components.setdefault(component, {})[name] = expression
        if not components:
            _no_costs(source, "there is no component")
        return Costs(components)

    @property
    def names(self) -> tuple[str, ...]:
        """The costs: their sums over the components are quantities by these names."""
        return tuple(dict.fromkeys(name for costs in self.components.values() for name in costs))

    @property
    def needs(self) -> tuple[str, ...]:
        """The names that the costs depend on."""
        found = (name for costs in self.components.values() for cost in costs.values() for name in cost.names)
        return tuple(dict.fromkeys(found))

    def totals(self, values: Values) -> dict[str, Float[np.ndarray, "..."]]:
        """Return the sum of each cost over the components."""
        return {name: np.asarray(sum(self.parts(name, values).values())) for name in self.names}

    def parts(self, name: str, values: Values) -> dict[str, Float[np.ndarray, "..."]]:
        """Return one cost by component."""
        return {part: costs[name].value(values) for part, costs in self.components.items() if name in costs}


COSTS_REMEDY = (
    "give a TOML file of [component] tables such as mass_kg = 0.3, or a CSV file whose first column names the "
    "components; a value is a number or an expression in quotes"
)


def read_costs(path: Path) -> Costs:
    """Return the costs in a TOML or CSV file; InputFileError for any other, ScenarioError for a wrong expression."""
    text = read_text(path, "--costs", COSTS_REMEDY)
    try:
        tables = _csv_tables(text) if path.suffix.lower() == ".csv" else parse_toml(text)
    except (ValueError, csv.Error) as error:
        _no_costs(f"--costs {shown(path)}", str(error))
    return Costs.of(tables, f"--costs {shown(path)}")


def _csv_tables(text: str) -> dict[str, dict[str, str]]:
    rows = list(csv.DictReader(io.StringIO(text, newline=""), strict=True))
    tables: dict[str, dict[str, str]] = {}
    for row in rows:
        if None in row or None in row.values():
            raise ValueError(f"line {len(tables) + 2} has another number of values than line 1")
        name, *values = row.values()
        if name in tables:
            raise ValueError(f"component {name} is there twice")
        keys = [key.strip() for key in row][1:]
        tables[name.strip()] = {key: value for key, value in zip(keys, values, strict=True) if value.strip()}
    return tables


def _no_costs(source: str, message: str) -> NoReturn:
    raise InputFileError(f"{source}: {message}; {COSTS_REMEDY}")
