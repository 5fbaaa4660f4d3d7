"""Expected cost of a survey: number of paths, memory, and time on two cores, to an order of magnitude.

The rates were measured on two cores over `hills`, `buildings`, `jacksboro` and `rain`, 600 to 3,000 pulses, as the
second flight of a process. Long flights take less a pulse: up to five times less (`docs/checks/speed.csv`).
"""

from dataclasses import dataclass

from sionna_radar.survey.preparation import Prepared

# Of the process before a survey, MB; of a triangle of the scene and of an echo of the map, bytes.
PROCESS_MB, TRIANGLE_BYTES, ECHO_BYTES = 600.0, 200.0, 500.0
# Pulses a second from the trace to the echoes, with this many paths each; through rain or snow, whose echo is added.
TRACED_PER_S, TRACED_PATHS, THROUGH_RAIN_PER_S = 4_000.0, 512, 110.0
# Pulses a second that the map takes; of another method as of the slowest.
MAPPED_PER_S = {"linear": 4_000.0, "smooth": 1_100.0, "refined": 660.0, "stepped": 820.0}


@dataclass(frozen=True, kw_only=True)
class Work:
    """Expected work of a survey; times of two cores."""

    paths: int
    memory_mb: float
    flight_s: float
    map_s: float


def expected_work(prepared: Prepared) -> Work:
    """Return the work that a survey is expected to take."""
    scenario, pulses = prepared.scenario, len(prepared)
    paths = scenario.tracing.paths
    triangles = sum(len(surface.faces) for surface in prepared.world.scene.surfaces)
    weather = scenario.weather
    raining = weather.rain_rate_mm_per_h > 0 or weather.snowfall_mm_per_h > 0 or weather.rain_field is not None
    traced_per_s = THROUGH_RAIN_PER_S if raining else TRACED_PER_S
    per_s = MAPPED_PER_S.get(scenario.dem.method, min(MAPPED_PER_S.values()))
    return Work(
        paths=pulses * paths,
        memory_mb=PROCESS_MB + 1e-6 * (TRIANGLE_BYTES * triangles + ECHO_BYTES * pulses),
        flight_s=pulses * max(paths / TRACED_PATHS, 0.5) / traced_per_s,
        map_s=pulses / per_s,
    )
