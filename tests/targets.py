"""A radar that looks straight down on a target."""

import numpy as np

from sionna_radar.flight.pulses import Pulses
from sionna_radar.scenario import Scenario, parse_scenario
from sionna_radar.survey.preparation import prepare
from sionna_radar.tracing.effects.targets import trace_targets
from sionna_radar.tracing.paths import Paths


def over_target(target: dict, rate_hz: float = 360.0, **platform: object) -> Scenario:
    """A radar looking straight down on a target, over level ground."""
    return parse_scenario(
        {
            "terrain": {"kind": "flat", "size_m": [300.0, 300.0]},
            "platform": {"altitude_m": 50.0, "speed_mps": 5.0, "length_m": 10.0} | platform,
            "radar": {
                "snr_db": 30.0,
                "chirp_rate_hz": rate_hz,
                "antenna": {"beamwidth_deg": 30.0},
                "scan": {"mode": "fixed", "incidence_deg": 0.0},
            },
            "targets": [target],
        }
    )


def target_paths(scenario: Scenario, pulses: np.ndarray) -> tuple[Pulses, Paths]:
    """Paths of the targets alone, in some pulses."""
    prepared = prepare(scenario)
    block = prepared.flight.pulses(pulses)
    scene = prepared.world.scene
    return block, trace_targets(
        scene.targets, block, prepared.instrument.antenna, prepared.receiver.chirp, prepared.world.caster, 1
    )
