"""Which settings of a scenario exclude each other: one row each, read by validation and by the reference of keys."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import reduce
from typing import Any

from sionna_radar.foundation.input_file import shown
from sionna_radar.scenario.parts import DEM_METHODS, SENSORS
from sionna_radar.scenario.radar import ElectronicScanTable
from sionna_radar.scenario.table import Conflicts, Table

# Longest range cell, m, in which "canopy" tells plants from ground: it tries heights a quarter of a cell apart.
LONGEST_CELL_M = 3.5
# A validated `scenario.Scenario`, which reads these rows.
Scenario = Any


@dataclass(frozen=True)
class Setting:
    """A setting that rows name.

    words: what it brings. key: the dotted key that brings it. is_set: whether a scenario has it.
    """

    words: str
    key: str
    is_set: Callable[[Scenario], bool]

    def value(self, scenario: Scenario) -> str:
        """Return its value as messages show it, with a space behind; empty for a table."""
        value = reduce(getattr, self.key.split("."), scenario)
        return "" if isinstance(value, Table) else f"{value:g} " if isinstance(value, float) else f"{shown(value)} "


@dataclass(frozen=True)
class Exclusion:
    """Two settings that a scenario cannot have at once; the key of the first is refused."""

    setting: Setting
    other: Setting
    remedy: str
    reason: str = ""

    def message(self, scenario: Scenario) -> str:
        """Return the problem with the value of the first key, and its remedy."""
        return f"{self.setting.value(scenario)}{self.words}; {self.remedy}"

    @property
    def words(self) -> str:
        """The row as a sentence without its subject."""
        return f"is not supported with {self.other.words}{', ' if self.reason else ''}{self.reason}"


def _profiles(scenario: Scenario) -> str:
    return DEM_METHODS.entry(scenario.dem.method).facts.profiles


def _in_air(scenario: Scenario) -> bool:
    return bool(scenario.weather.falling) or scenario.weather.dust_visibility_m is not None


def _imperfect(scenario: Scenario) -> bool:
    receiver = scenario.radar.receiver
    filtered = receiver.high_pass_corner_hz > 0 or receiver.anti_alias_corner_hz > 0
    return bool(filtered or receiver.leakage or receiver.stages)


def _averages(scenario: Scenario, coherent: bool) -> bool:
    average = scenario.processing.average
    return average.chirps > 1 and (average.mode == "coherent") is coherent


def _hides_plants(scenario: Scenario) -> bool:
    # SciPy is slow to import.
    from scipy.constants import speed_of_light

    cell_m = speed_of_light / (2 * scenario.radar.bandwidth_hz)
    tallest_m: float = getattr(scenario.dem.method_parameters, "max_plants_m", LONGEST_CELL_M)
    return scenario.dem.method == "canopy" and cell_m > min(tallest_m, LONGEST_CELL_M)


MODE, ANGLE_KEY, RANGING, METHOD = "processing.average.mode", "processing.angle", "processing.ranging", "dem.method"
SQUINT_KEY, SCAN = "radar.antenna.squint_deg_per_ghz", "radar.scan.mode"
ANGLE = Setting("several receivers", ANGLE_KEY, lambda s: s.processing.angle != "off")
AVERAGE = Setting("averaged chirps", "processing.average.chirps", lambda s: s.processing.average.chirps > 1)
COHERENT = Setting("coherent averages", MODE, lambda s: _averages(s, coherent=True))
POWERS = Setting("averaged powers", MODE, lambda s: _averages(s, coherent=False))
SQUINT = Setting("a beam that squints", SQUINT_KEY, lambda s: s.radar.antenna.squint_deg_per_ghz != 0)
GATE = Setting("a range gate", "radar.gate_delay_us", lambda s: s.radar.gate_delay_us > 0)
ANOTHER_SENSOR = Setting("a sensor other than 'radar'", "sensor", lambda s: s.sensor != "radar")
MIMO = Setting("frames of an array", "sensor", lambda s: s.sensor == "mimo")
FRAMES = Setting(MIMO.words, MIMO.key, lambda s: MIMO.is_set(s) and s.radar.array is not None)
PAIRS = Setting("pairs of sweeps", "radar.sweep", lambda s: s.radar.sweep == "triangular")
STAGGER = Setting("staggered intervals", "radar.stagger", lambda s: s.radar.stagger > 0)
STEERED = Setting("electronically steered beams", SCAN, lambda s: isinstance(s.radar.scan, ElectronicScanTable))
TURNING = Setting("a beam that turns", SCAN, lambda s: s.radar.scan.mode not in ("fixed", "side_looking"))
IN_AIR = Setting("rain, snow or dust", "weather", _in_air)
BOUNCES = Setting("two bounces", "tracing.bounces", lambda s: s.tracing.bounces > 1)
NEW_SPECKLE = Setting("speckle drawn anew", "tracing.speckle", lambda s: s.tracing.speckle == "per_pulse")
IMPERFECT = Setting("filters or leakage", "radar.receiver", _imperfect)
ORDERED_CFAR = Setting("a CFAR other than 'CA'", "processing.cfar.kind", lambda s: s.processing.cfar.kind != "CA")
ALL_ECHOES = Setting("all echoes of a pulse", "processing.echoes", lambda s: s.processing.echoes == "all")
CLUTTER = Setting("a search for rain", "processing.volume_clutter", lambda s: s.processing.volume_clutter != "off")
GATED_AIR = Setting("rain, snow or dust before the range gate", "weather", lambda s: _in_air(s) and GATE.is_set(s))
TRACKER = Setting("a tracking loop", RANGING, lambda s: s.processing.ranging == "tracker" and s.sensor == "radar")
REFINED = Setting("refined navigation", "processing.navigation", lambda s: s.processing.navigation == "refined")
PROFILES = Setting("maps of whole echoes", METHOD, lambda s: _profiles(s) == "required")
MODELS = Setting("maps that model echoes", METHOD, lambda s: _profiles(s) != "unused")
CANOPY = Setting("maps of plants and ground", METHOD, lambda s: s.dem.method == "canopy")
LONG_CELLS = Setting("range cells longer than plants are tall", "radar.bandwidth_hz", _hides_plants)
NO_PROFILES = Setting(
    "a sensor without range profiles", "sensor", lambda s: not SENSORS.entry(s.sensor).facts.provides_profiles
)

EXCLUSIONS = (
    Exclusion(ALL_ECHOES, PAIRS, "give 'strongest' or 'first'", "whose echoes cannot be paired"),
    Exclusion(PROFILES, NO_PROFILES, "set 'smooth' or 'linear'"),
    Exclusion(PROFILES, PAIRS, "set 'smooth' or 'linear', or radar.sweep = 'up'", "which have no common profile"),
    Exclusion(CANOPY, LONG_CELLS, "raise radar.bandwidth_hz, or set 'refined'", "which hold both at once"),
    Exclusion(ANGLE, ANOTHER_SENSOR, "set 'off', or sensor = 'radar'"),
    Exclusion(ANGLE, PAIRS, "set radar.sweep = 'up'"),
    Exclusion(ANGLE, STEERED, "set another radar.scan.mode"),
    Exclusion(ANGLE, IN_AIR, "remove the weather"),
    Exclusion(PROFILES, ANGLE, "set 'linear' or 'smooth'", "which give points without range profiles"),
    Exclusion(GATE, MIMO, "set 0"),
    Exclusion(SQUINT, MIMO, "set 0"),
    Exclusion(PAIRS, FRAMES, "set 'up'"),
    Exclusion(STAGGER, FRAMES, "set 0"),
    Exclusion(TURNING, FRAMES, "set 'fixed'", "whose elements would move during a frame"),
    Exclusion(NEW_SPECKLE, FRAMES, "set 'persistent'", "whose phases last from chirp to chirp"),
    Exclusion(IMPERFECT, FRAMES, "remove its other keys", "whose receivers have thermal noise and radar.array only"),
    Exclusion(CLUTTER, GATED_AIR, "set 'off', or remove the weather or the gate"),
    Exclusion(SQUINT, ANGLE, "set 0, or processing.angle = 'off'"),
    Exclusion(SQUINT, STEERED, "set 0, or another radar.scan.mode"),
    Exclusion(SQUINT, IN_AIR, "set 0", "whose echoes are those of the whole beam"),
    Exclusion(SQUINT, BOUNCES, "set 0, or tracing.bounces = 1", "which leave and arrive at different angles"),
    Exclusion(AVERAGE, ANOTHER_SENSOR, "set 1, or sensor = 'radar'"),
    Exclusion(AVERAGE, PAIRS, "set 1, or radar.sweep = 'up'"),
    Exclusion(AVERAGE, STAGGER, "set 1, or radar.stagger = 0"),
    Exclusion(AVERAGE, STEERED, "set 1", "which are steered anew for each chirp"),
    Exclusion(AVERAGE, IN_AIR, "set 1, or remove the weather"),
    Exclusion(COHERENT, NEW_SPECKLE, "set tracing.speckle = 'persistent'", "which differs between the chirps"),
    Exclusion(ORDERED_CFAR, POWERS, "set 'CA'", "over which it has no false-alarm rate in closed form"),
    Exclusion(POWERS, ANGLE, "set 'coherent'", "which need phases"),
    Exclusion(MODELS, POWERS, "set 'linear', or processing.average.mode = 'coherent'", "which are not single chirps"),
    Exclusion(REFINED, NO_PROFILES, "set 'reported', or sensor = 'radar'", "from which it is estimated"),
    Exclusion(REFINED, PAIRS, "set 'reported', or radar.sweep = 'up'", "which have no common profile"),
    Exclusion(REFINED, ANGLE, "set 'reported', or processing.angle = 'off'", "which give points without profiles"),
    Exclusion(REFINED, POWERS, "set 'reported', or 'coherent' averages", "which are not single chirps"),
    Exclusion(TRACKER, ALL_ECHOES, "set processing.echoes = 'strongest'", "of which it follows one"),
    Exclusion(TRACKER, ANGLE, "set processing.angle = 'off'"),
    Exclusion(TRACKER, TURNING, "set radar.scan.mode = 'fixed'", "and whose pulses see different ranges"),
)


def exclusions(scenario: Scenario) -> Conflicts:
    """Yield the key and the message of each row that a scenario contradicts."""
    for row in EXCLUSIONS:
        if row.setting.is_set(scenario) and row.other.is_set(scenario):
            yield row.setting.key, row.message(scenario)


def excluded_with(key: str) -> Iterator[str]:
    """Yield in words, for the description of a key, the settings that it is not supported with."""
    for row in EXCLUSIONS:
        if row.setting.key == key:
            yield row.other.words
        elif row.other.key == key:
            yield row.setting.words
