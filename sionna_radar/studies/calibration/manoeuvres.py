"""Further lines over the same reference, and what they would add to an estimate: turned, higher, faster or rocking."""

from dataclasses import replace

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from sionna_radar.elevation.heightfield import Heightfield
from sionna_radar.flight.instrument import BelievedMotion
from sionna_radar.flight.pulses import Pose
from sionna_radar.mapping.navigation.echo_errors import RangeProfiles
from sionna_radar.studies.calibration.estimation import Solution
from sionna_radar.studies.calibration.instrument_echoes import CombinedEchoes

# Manoeuvres: how a line is flown again. Rocking is a roll to and fro, by a pilot or an autopilot without effort.
HIGHER, FASTER, ROCKING_DEG, ROCKING_S = 2.0, 2.0, 10.0, 6.0
# Length of rays that look for the middle of a line.
FOLLOWED_M = 1e5


def information_of_lines(
    parts: CombinedEchoes, surface: Heightfield, solution: Solution
) -> dict[str, Float[np.ndarray, "k k"]]:
    """Return the information that one more line of each kind would add, like the longest that was flown."""
    line, drift = parts.line, solution.drift
    longest = np.bincount(line).argmax()
    first, found = 0, {}
    for part in parts.parts:
        own = line[first : first + len(part)] == longest
        if own.any():
            one, sigma_m = part.rows(own), float(np.nanmedian(solution.step.sigma_m[first : first + len(part)][own]))
            break
        first += len(part)
    for name, motion in _lines(one.motion, surface).items():
        information = one.expected(motion, solution.errors, surface, drift.all_names, sigma_m) / solution.scatter
        if isinstance(one, RangeProfiles) and one.rates is not None:
            flown = replace(one, rates=replace(one.rates, motion=_lines(one.rates.motion, surface)[name]))
            information += flown.doppler_information(solution.errors, drift.all_names)[0]
        found[name] = drift.eliminated(
            information, np.zeros(len(drift.all_names)), np.zeros(len(drift.own))
        ).information
    return found


def _lines(flown: BelievedMotion, surface: Heightfield) -> dict[str, BelievedMotion]:
    """Return the motions of other lines over the same place."""
    pose, body = flown.pose, flown.R_world_mount
    ground = surface.first_hit(pose.position_m, pose.boresight, FOLLOWED_M)
    met = np.isfinite(ground)
    centre = (pose.position_m + np.where(met, ground, 0.0)[:, None] * pose.boresight)[met].mean(axis=0)
    height = float(np.mean(pose.position_m[:, 2] - centre[2]))

    raised = replace(pose, position_m=pose.position_m + np.array([0.0, 0.0, (HIGHER - 1) * height]))
    faster = replace(pose, velocity_mps=FASTER * pose.velocity_mps)
    phase, amplitude = 2 * np.pi * (flown.time_s - flown.time_s[0]) / ROCKING_S, np.deg2rad(ROCKING_DEG)
    nose = body[:, :, 0]
    roll = Rotation.from_rotvec(nose * (amplitude * np.sin(phase))[:, None]).as_matrix()
    rate = nose * (amplitude * 2 * np.pi / ROCKING_S * np.cos(phase))[:, None]
    rocking = replace(pose, R_world_antenna=roll @ pose.R_world_antenna)
    return {
        "the same line again": flown,
        "the opposite line": _turned(flown, centre, 180.0),
        "a crossing line": _turned(flown, centre, 90.0),
        f"the line at {HIGHER:g} times the height": replace(flown, pose=raised),
        f"the line at {FASTER:g} times the speed": replace(flown, pose=faster),
        f"the line while rolling by ±{ROCKING_DEG:g}° every {ROCKING_S:g} s, antenna fixed to the body": replace(
            flown, pose=rocking, turn_rad_s=flown.turn_rad_s + rate
        ),
    }


def _turned(flown: BelievedMotion, centre: Float[np.ndarray, "3"], degrees: float) -> BelievedMotion:
    """Return a motion turned about the vertical through a place."""
    pose, R = flown.pose, Rotation.from_euler("z", degrees, degrees=True).as_matrix()
    middle = np.array([centre[0], centre[1], 0.0])
    moved = Pose(
        position_m=(pose.position_m - middle) @ R.T + middle,
        velocity_mps=pose.velocity_mps @ R.T,
        R_world_antenna=R @ pose.R_world_antenna,
    )
    return replace(
        flown, pose=moved, turn_rad_s=flown.turn_rad_s @ R.T, acceleration_mps2=flown.acceleration_mps2 @ R.T
    )
