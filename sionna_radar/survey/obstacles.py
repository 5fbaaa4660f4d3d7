"""Obstacles of a survey: echoes from above the map are reported, and held against the truth."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Int

from sionna_radar.accuracy.obstacles import Inventory, Looks, SeenObstacle, identities, seen_obstacles
from sionna_radar.flight.pulses import Pose
from sionna_radar.mapping.mapper import Estimate, Mapper
from sionna_radar.mapping.obstacles import ObstacleRule, ReportedObstacles, reported_obstacles
from sionna_radar.mapping.points import Points
from sionna_radar.scenario import Scenario
from sionna_radar.scenario.recorded import RecordedSettings

MINUTE_S, KM2 = 60.0, 1e6
# Obstacles that a report is expected of; a map shows the others.
REPORTABLE = ("wires", "poles", "fences", "targets")
Poses = Callable[[Int[np.ndarray, " pulse"]], Pose]


def reports_obstacles(settings: Scenario | RecordedSettings) -> bool:
    """Return True if obstacles are reported: if not set, where the scene has wires, poles or fences."""
    report = settings.processing.obstacles.report
    if report is None:
        return isinstance(settings, Scenario) and bool(settings.wires or settings.poles or settings.fences)
    return report


def rule_of(settings: Scenario | RecordedSettings, cell_m: float, max_gap_m: float) -> ObstacleRule | None:
    """Return the thresholds by which obstacles are reported; None if none are.

    cell_m: length of a range cell. max_gap_m: the map's largest gap, over which echoes are linked.
    """
    processing = settings.processing
    if not reports_obstacles(settings):
        return None
    table = processing.obstacles
    return ObstacleRule(
        sigmas=table.sigmas,
        min_probability=table.min_probability,
        false_alarm_probability=processing.cfar.false_alarm_probability,
        cell_m=cell_m,
        min_range_m=processing.min_range_m,
        link_m=max_gap_m,
    )


@dataclass(frozen=True, kw_only=True)
class ObstacleReport:
    """Obstacles that were reported, and, where the truth is known, what they are.

    reported: by the processing, without the truth.
    seen: every obstacle of the scene, and what was seen of it; empty where the scene is not known.
    of: number of the obstacle in `seen` that each reported one is; -1 for a false alarm; None without the truth.
    detected: numbers of the obstacles whose echoes reported ones hold, several of them where they stand side by side.
    false_per_km2, false_per_minute: false alarms over the mapped area, and over the time of flight.
    """

    reported: ReportedObstacles | None
    seen: tuple[SeenObstacle, ...] = ()
    of: Int[np.ndarray, " obstacle"] | None = None
    detected: tuple[int, ...] = ()
    false_per_km2: float = float("nan")
    false_per_minute: float = float("nan")

    def rates(self) -> dict[str, float]:
        """Return the rates of reports by name; NaN where undefined.

        pd_wire, pd_obstacle: share of the wires, and of all thin obstacles and targets, that were reported.
        warning_s: the least time between the report of one of them and reaching it; zero if none is.
        """
        targets = [n for n, one in enumerate(self.seen) if one.kind in REPORTABLE]
        wires = [n for n in targets if self.seen[n].kind == "wires"]
        times = [self.seen[n].report_warning_s for n in targets]
        return {
            "pd_wire": self._detected_fraction(wires),
            "pd_obstacle": self._detected_fraction(targets),
            "warning_s": float(np.nanmin(times)) if np.isfinite(times).any() else 0.0 if targets else float("nan"),
            "false_alarms_per_km2": self.false_per_km2,
            "false_alarms_per_minute": self.false_per_minute,
        }

    def _detected_fraction(self, numbers: list[int]) -> float:
        return float(np.isin(numbers, self.detected).mean()) if numbers and self.of is not None else float("nan")


def report_obstacles(
    points: Points, estimate: Estimate, mapper: Mapper, measured: Poses, pulses: int
) -> tuple[ReportedObstacles | None, Int[np.ndarray, " point"]]:
    """Return the obstacles that a survey reports, None without a rule or an antenna, and that of each point or -1."""
    rule = mapper.obstacles
    if rule is None or mapper.antenna is None:
        return None, np.full(len(points), -1)
    pose = measured(points.pulse)
    return reported_obstacles(points, pose, mapper.antenna, estimate.dem, estimate.sigma, rule, pulses)


def held_against_truth(
    reported: ReportedObstacles | None,
    member: Int[np.ndarray, " point"],
    inventory: Inventory,
    looks: Looks,
    points: Points,
    least_power: float,
    mapped_m2: float,
    duration_s: float,
) -> ObstacleReport:
    """Return the reported obstacles with what each is: the obstacle that most of its echoes are of, or none.

    member: number of the reported obstacle of each point; -1 for none.
    least_power: over the transmitted power, that noise lets pass.
    """
    identity = identities(looks, points)
    count = 0 if reported is None else len(reported)
    of = np.full(count, -1)
    reports: dict[int, int] = {}
    for number in range(count):
        names, votes = np.unique(identity[member == number], return_counts=True)
        of[number] = names[np.argmax(votes)]
        pulse = int(reported.report_pulse[number]) if reported is not None else 0
        for name in names[names >= 0].tolist() if of[number] >= 0 else []:
            reports[name] = min(pulse, reports.get(name, pulse))
    false = int(np.count_nonzero(of < 0))
    return ObstacleReport(
        reported=reported,
        seen=seen_obstacles(inventory.obstacles, looks, points, least_power, reports),
        of=None if reported is None else of,
        detected=tuple(reports),
        false_per_km2=false * KM2 / mapped_m2 if mapped_m2 > 0 and reported is not None else float("nan"),
        false_per_minute=false * MINUTE_S / duration_s if duration_s > 0 and reported is not None else float("nan"),
    )
