"""Point targets by the radar equation: constant or fluctuating cross-section, at rest or moving.

Swerling's cases draw the cross-section about its mean: 1 and 2 from an exponential distribution, as of many scatterers
alike, 3 and 4 from a chi-squared one with four degrees of freedom, as of a large scatterer among small ones; 1 and 3
once per scan, 2 and 4 for every pulse. Source: Swerling 1954, RAND RM-1217, as restated in "Chi-squared target
models" (handwiki.org) and in AGI's description of its SwerlingTargetModel.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from sionna_radar.flight.pulses import Pulses
from sionna_radar.foundation.randomness import Stream, pulse_uniforms
from sionna_radar.radar.antenna import Antenna
from sionna_radar.radar.chirp import Chirp
from sionna_radar.scene.model import Body, Target
from sionna_radar.scene.raycast import RayCaster
from sionna_radar.tracing.effects.bodies import beyond_body, trace_body
from sionna_radar.tracing.effects.physical_optics import scatterer_of
from sionna_radar.tracing.paths import FIRST_OBSTACLE, TARGET, Paths

# A target on the ground touches the mesh; rays that end this far short of it still see it.
TOUCHING_M = 0.05


def trace_targets(
    targets: Sequence[Target], pulses: Pulses, antenna: Antenna, chirp: Chirp, caster: RayCaster, seed: int = 0
) -> Paths:
    """Return the paths of visible targets, sorted by pulse.

    |gain|^2 = G^2 lambda^2 sigma / ((4 pi)^3 r^4) (Rouveure et al. 2017, eq. 3), with zero phase apart from the
    delay, as of a fixed point. A moving target and its rotors are where they are in the middle of the chirp, and move
    on evenly during it.

    seed: of the fluctuations.
    """
    places = [_shown(target, number, pulses, seed) for number, target in enumerate(targets)]
    parts = [
        _numbered(
            _of_points(shown, pulses, antenna, chirp, caster)
            if target.body is None
            else _of_body(target.body, shown, pulses, antenna, chirp, caster),
            number,
        )
        for number, (target, shown) in enumerate(zip(targets, places, strict=True))
    ]
    return Paths.concatenate(parts)


def _numbered(paths: Paths, number: int) -> Paths:
    return replace(paths, surface=np.full(len(paths), FIRST_OBSTACLE - number))


def seen_past(targets: Sequence[Target], paths: Paths, pulses: Pulses, chirp: Chirp) -> Paths:
    """Return the paths of a block that no target with a shape hides."""
    for number, target in enumerate(targets):
        if target.body is None:
            continue
        shown = _shown(target, number, pulses, 0)
        scatterer = scatterer_of(target.body, chirp.wavelength_m)
        paths = paths.rows(~beyond_body(scatterer, paths, pulses, shown.position_m[:, 0], shown.heading_rad))
    return paths


def _of_points(shown: "_Shown", pulses: Pulses, antenna: Antenna, chirp: Chirp, caster: RayCaster) -> Paths:
    pose = pulses.true
    away = (shown.position_m - pose.position_m[:, None]).reshape(-1, 3)
    row = np.repeat(np.arange(len(pulses)), shown.position_m.shape[1])
    range_m = np.linalg.norm(away, axis=1)
    direction = away / range_m[:, None]
    gain = antenna.gain(np.einsum("nij,ni->nj", pose.R_world_antenna[row], direction))
    spread = (4 * np.pi) ** 3 * range_m**4
    power = gain**2 * chirp.wavelength_m**2 * shown.rcs_m2.ravel() / spread * abs(antenna.mirrored) ** 2
    seen = power > 0
    hit = pose.position_m[row] + away
    seen[seen] = caster.visible(pose.position_m[row][seen], hit[seen], TOUCHING_M)
    paths = Paths.to_points(
        pulses,
        row[seen],
        hit[seen],
        gain=np.sqrt(power[seen]).astype(np.complex128),
        incidence_rad=np.full(int(seen.sum()), np.nan),
        surface=np.full(int(seen.sum()), TARGET),
    )
    if shown.still:
        return paths
    receding = np.einsum("ni,ni->n", shown.velocity_mps.reshape(-1, 3)[seen], direction[seen])
    return replace(paths, range_rate_mps=paths.range_rate_mps + receding)


def _of_body(body: Body, shown: "_Shown", pulses: Pulses, antenna: Antenna, chirp: Chirp, caster: RayCaster) -> Paths:
    place, velocity = shown.position_m[:, 0], shown.velocity_mps[:, 0]
    paths = trace_body(scatterer_of(body, chirp.wavelength_m), pulses, place, shown.heading_rad, antenna, chirp)
    row = pulses.row_of(paths.pulse)
    origin = pulses.true.position_m[row]
    seen = caster.visible(origin, paths.hit_m, TOUCHING_M) if len(row) else np.zeros(0, dtype=bool)
    away = paths.hit_m - origin
    receding = np.einsum("ni,ni->n", velocity[row], away) / np.linalg.norm(away, axis=1)
    moving = replace(paths, range_rate_mps=paths.range_rate_mps + receding).rows(seen)
    if shown.position_m.shape[1] == 1:
        return moving
    rotors = _of_points(shown.rotors, pulses, antenna, chirp, caster)
    return Paths.concatenate([moving, rotors])


@dataclass(frozen=True, kw_only=True)
class _Shown:
    """A target's own point and those of its rotors, at each pulse.

    still: whether none of them moves.
    """

    position_m: Float[np.ndarray, "pulse point 3"]
    velocity_mps: Float[np.ndarray, "pulse point 3"]
    rcs_m2: Float[np.ndarray, "pulse point"]
    heading_rad: Float[np.ndarray, " pulse"]
    still: bool

    @property
    def rotors(self) -> "_Shown":
        """The rotors alone."""
        position, velocity, rcs_m2 = self.position_m[:, 1:], self.velocity_mps[:, 1:], self.rcs_m2[:, 1:]
        return replace(self, position_m=position, velocity_mps=velocity, rcs_m2=rcs_m2)


def _shown(target: Target, number: int, pulses: Pulses, seed: int) -> _Shown:
    """Return the positions, velocities, cross-sections and headings of a target, for each pulse."""
    time_s, count = pulses.time_s, len(pulses)
    place, velocity = np.tile(np.array(target.position_m), (count, 1)), np.zeros((count, 3))
    heading = np.full(count, target.heading_rad)
    if target.way is not None:
        place, velocity = target.way.at(time_s)
        heading = target.way.heading_rad(time_s)
    rcs_m2 = cross_section(target, number, pulses, seed)
    if target.rcs_table is not None:
        toward = pulses.true.position_m - place
        toward = toward / np.linalg.norm(toward, axis=1)[:, None]
        rcs_m2 = rcs_m2 * target.rcs_table.toward(toward, heading)
    places, velocities, levels = [place[:, None]], [velocity[:, None]], [rcs_m2[:, None]]
    for rotor in target.rotors:
        offset, turning = rotor.at(time_s, heading)
        places.append(place[:, None] + offset)
        velocities.append(velocity[:, None] + turning)
        levels.append(np.full(offset.shape[:2], rotor.rcs_m2 / rotor.points))
    return _Shown(
        position_m=np.concatenate(places, axis=1),
        velocity_mps=np.concatenate(velocities, axis=1),
        rcs_m2=np.concatenate(levels, axis=1),
        heading_rad=heading,
        still=target.way is None and not target.rotors,
    )


def cross_section(target: Target, number: int, pulses: Pulses, seed: int) -> Float[np.ndarray, " pulse"]:
    """Return the cross-section of a target at each pulse; of one with a table, its factor on that.

    number: index of the target in its scene; it and the seed alone determine the fluctuation.
    """
    mean_m2 = target.rcs_m2 if target.rcs_table is None else 1.0
    if target.swerling == 0:
        return np.full(len(pulses), mean_m2)
    if target.swerling in (2, 4):
        drawn = pulse_uniforms(seed, Stream.TARGETS, pulses.index, 2, item=number)
    else:
        number_of_scan = np.zeros(len(pulses), np.int64) if pulses.scan_number is None else pulses.scan_number
        scan, back = np.unique(number_of_scan, return_inverse=True)
        drawn = pulse_uniforms(seed, Stream.TARGET_SCANS, scan, 2, item=number)[back]
    exponential = -np.log1p(-drawn)
    # The mean of two exponentials is chi-squared with four degrees of freedom.
    share = exponential[:, 0] if target.swerling in (1, 2) else exponential.mean(axis=1)
    return mean_m2 * share
