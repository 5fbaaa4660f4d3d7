"""What a survey is expected to take: pulses, paths, memory, and time of two cores.

The rates are those of `docs/checks/speed.csv`, measured on two cores; a survey may take half or twice as long.
"""

from dataclasses import dataclass

from sionna_radar.survey.preparation import Prepared

# Of the process before a survey, MB; of a triangle of the scene and of an echo of the map, bytes.
PROCESS_MB, TRIANGLE_BYTES, ECHO_BYTES = 600.0, 200.0, 500.0
# Pulses a second from the trace to the echoes, with this many paths each.
TRACED_PER_S, TRACED_PATHS = 13_000.0, 512
# Pulses a second that the map takes; of another method as of the slowest.
MAPPED_PER_S = {"linear": 65_000.0, "smooth": 10_000.0, "refined": 5_000.0, "stepped": 1_000.0}


@dataclass(frozen=True, kw_only=True)
class Work:
    """Expected work of a survey; times of two cores."""

    pulses: int
    paths: int
    memory_mb: float
    flight_s: float
    map_s: float


def expected_work(prepared: Prepared) -> Work:
    """Return the work that a survey is expected to take."""
    scenario, pulses = prepared.scenario, len(prepared)
    paths = scenario.tracing.paths_per_pulse
    triangles = sum(len(surface.faces) for surface in prepared.scene.scene.surfaces)
    per_s = MAPPED_PER_S.get(scenario.dem.method, min(MAPPED_PER_S.values()))
    return Work(
        pulses=pulses,
        paths=pulses * paths,
        memory_mb=PROCESS_MB + 1e-6 * (TRIANGLE_BYTES * triangles + ECHO_BYTES * pulses),
        flight_s=pulses * max(paths / TRACED_PATHS, 0.5) / TRACED_PER_S,
        map_s=pulses / per_s,
    )
