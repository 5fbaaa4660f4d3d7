"""Echoes and radar cross-section of targets with a shape, by physical optics on their visible faces.

Paths come in small steps of range. The cross-section, from all sides, is by physical optics and further reflections
between the faces.
"""

from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Complex, Float, Int
from scipy.constants import speed_of_light

from sionna_radar.flight.pulses import Pulses
from sionna_radar.radar.antenna import Antenna
from sionna_radar.radar.chirp import Chirp
from sionna_radar.scene.motion import level_axes
from sionna_radar.tracing.effects.bouncing_rays import BouncedEchoes, bounced_echoes
from sionna_radar.tracing.effects.physical_optics import Scatterer
from sionna_radar.tracing.paths import TARGET, VOLUME, Paths

# Axes of a body, among forward, right and up.
RIGHT_FORWARD_UP = [1, 0, 2]
# Faces within such a share of a range cell are one path.
STEP_CELLS = 1 / 8
# Faces of all pulses that are handled at once.
AT_ONCE = 2_000_000
# Of rays from face to face, at most some in a square of the wavelength's side.
TUBES = 8
# Of the antenna's gain, two ways a millionth: less is not worth to follow rays from face to face.
MIN_GAIN = 1e-3


def trace_body(
    scatterer: Scatterer,
    pulses: Pulses,
    place_m: Float[np.ndarray, "pulse 3"],
    heading_rad: Float[np.ndarray, " pulse"],
    antenna: Antenna,
    chirp: Chirp,
) -> Paths:
    """Return the paths to a body that is at a place, turned to a heading (clockwise from north), at each pulse.

    Nothing hides it but itself.
    """
    R_world_body = level_axes(heading_rad)[:, :, RIGHT_FORWARD_UP]
    tubes = 0
    if scatterer.sees_itself:
        area_m2 = np.linalg.norm(scatterer.normal_m2, axis=1).sum()
        tubes = int(TUBES * area_m2 / scatterer.wavelength_m**2)
    few = max(1, AT_ONCE // (len(scatterer.body.faces) + tubes))
    pieces = []
    for low in range(0, len(pulses), few):
        rows = slice(low, low + few)
        pieces.append(_trace(scatterer, pulses.rows(rows), place_m[rows], R_world_body[rows], antenna, chirp))
    return Paths.concatenate(pieces)


def _trace(
    scatterer: Scatterer,
    pulses: Pulses,
    place_m: Float[np.ndarray, "pulse 3"],
    R_world_body: Float[np.ndarray, "pulse 3 3"],
    antenna: Antenna,
    chirp: Chirp,
) -> Paths:
    pose, wavelength_m = pulses.true, chirp.wavelength_m
    radar_m = np.einsum("pji,pj->pi", R_world_body, pose.position_m - place_m)
    amplitude = scatterer.amplitude(radar_m)
    row, face = np.nonzero(amplitude)
    echo_field, place, bounced = amplitude[row, face] * abs(antenna.mirrored), scatterer.middle_m[face], None
    if scatterer.sees_itself:
        bounced = _bounced(scatterer, pulses, place_m, R_world_body, radar_m, antenna)
        row, place = np.concatenate([row, bounced.row]), np.concatenate([place, bounced.place_m])
        echo_field = np.concatenate([echo_field, bounced.amplitude])
    if len(row) == 0:
        return _to(pulses, row, np.zeros((0, 3)), np.zeros(0, dtype=np.complex128))
    middle = place_m[row] + np.einsum("nij,nj->ni", R_world_body[row], place)
    away = middle - pose.position_m[row]
    range_m = np.linalg.norm(away, axis=1)
    direction = np.einsum("nij,ni->nj", pose.R_world_antenna[row], away / range_m[:, None])
    if bounced is not None:
        range_m[len(row) - len(bounced) :] = bounced.range_m
    # The square root of the radar equation (Rouveure et al. 2017, eq. 3).
    field = antenna.gain(direction) * wavelength_m / ((4 * np.pi) ** 1.5 * range_m**2) * echo_field
    step_m = STEP_CELLS * chirp.range_resolution_m
    number = np.floor(range_m / step_m).astype(np.int64)
    ahead_m = range_m - (number + 0.5) * step_m
    field = field * np.exp(-4j * np.pi / wavelength_m * ahead_m)
    # A table of pulses and steps of range: sorting the faces would take longer than all else.
    nearest = int(number.min())
    steps = int(number.max()) - nearest + 1
    of = row * steps + number - nearest
    faces = np.bincount(of, minlength=len(pulses) * steps)
    group = np.flatnonzero(faces)
    gain = np.bincount(of, field.real, len(faces))[group] + 1j * np.bincount(of, field.imag, len(faces))[group]
    hit_m = np.stack([np.bincount(of, column, len(faces))[group] / faces[group] for column in middle.T], axis=1)
    member, step = np.divmod(group, steps)
    paths = _to(pulses, member, hit_m, gain)
    return replace(paths, delay_s=2 / speed_of_light * (step + nearest + 0.5) * step_m)


def _bounced(
    scatterer: Scatterer,
    pulses: Pulses,
    place_m: Float[np.ndarray, "pulse 3"],
    R_world_body: Float[np.ndarray, "pulse 3 3"],
    radar_m: Float[np.ndarray, "pulse 3"],
    antenna: Antenna,
) -> BouncedEchoes:
    """Return the multiple-reflection echoes of a body, in pulses whose beam is on it."""
    away = place_m + R_world_body @ scatterer.sphere[0] - pulses.true.position_m
    turn = pulses.true.R_world_antenna
    ahead = np.einsum("pij,pi->pj", turn, away / np.linalg.norm(away, axis=1)[:, None])
    lit = np.flatnonzero(antenna.gain(ahead) > MIN_GAIN * antenna.peak_gain)
    sent, received = (
        np.einsum("pki,pkj,pj->pi", R_world_body[lit], turn[lit], field) for field in antenna.fields(ahead[lit])
    )
    echoes = bounced_echoes(scatterer, radar_m[lit], sent, received)
    return replace(echoes, row=lit[echoes.row])


def _to(
    pulses: Pulses,
    row: Int[np.ndarray, " path"],
    hit_m: Float[np.ndarray, "path 3"],
    gain: Complex[np.ndarray, " path"],
) -> Paths:
    nowhere = np.full(len(row), np.nan)
    return Paths.to_points(pulses, row, hit_m, gain=gain, incidence_rad=nowhere, surface=np.full(len(row), TARGET))


def beyond_body(
    scatterer: Scatterer,
    paths: Paths,
    pulses: Pulses,
    place_m: Float[np.ndarray, "pulse 3"],
    heading_rad: Float[np.ndarray, " pulse"],
) -> Bool[np.ndarray, " path"]:
    """Return a mask of the paths of a block that a body hides: it stands between the radar and their scatterers."""
    row = pulses.row_of(paths.pulse)
    radar, hit = pulses.true.position_m[row], paths.hit_m
    away = hit - radar
    length_m = np.linalg.norm(away, axis=1)
    middle_m, radius_m = scatterer.sphere
    R_world_body = level_axes(heading_rad)[:, :, RIGHT_FORWARD_UP]
    centre = (place_m + R_world_body @ middle_m)[row] - radar
    along_m = np.einsum("ni,ni->n", centre, away) / np.maximum(length_m, 1e-9)
    aside_m = np.sqrt(np.maximum(np.einsum("ni,ni->n", centre, centre) - along_m**2, 0.0))
    near = (aside_m < radius_m) & (along_m > -radius_m) & (along_m < length_m + radius_m) & (length_m > 0)
    hidden = np.zeros(len(paths), dtype=bool)
    candidates = np.flatnonzero(near & (paths.surface != VOLUME))
    if len(candidates):
        turn, origin = R_world_body[row[candidates]], place_m[row[candidates]]
        ends = [
            np.einsum("nji,nj->ni", turn, place - origin)
            for place in (radar[candidates], hit[candidates].astype(np.float64))
        ]
        hidden[candidates] = scatterer.hides(*ends)
    return hidden


# Sine of the elevation above which a direction has no plane of the upward axis.
UPRIGHT = 0.9999


def rcs_m2(scatterer: Scatterer, toward: Float[np.ndarray, "n 3"], range_m: float) -> Float[np.ndarray, " n"]:
    """Return the cross-section seen from a range, in directions from the body (unit vectors in its axes).

    Where it sees itself, of a wave whose field lies in the plane of its upward axis.
    """
    result = np.empty(len(toward))
    for number, one in enumerate(toward):
        place = one[None] * range_m
        away_m = np.linalg.norm(scatterer.middle_m - place, axis=1)
        amplitude = scatterer.amplitude(place)[0]
        if scatterer.sees_itself:
            up = np.eye(3)[1 if abs(one[2]) > UPRIGHT else 2]
            field = (up - (up @ one) * one)[None] / np.sqrt(1 - (up @ one) ** 2)
            bounced = bounced_echoes(scatterer, place, field, field)
            away_m, amplitude = np.append(away_m, bounced.range_m), np.append(amplitude, bounced.amplitude)
        phase = np.exp(-4j * np.pi / scatterer.wavelength_m * (away_m - range_m))
        # The radar equation with the range of each face.
        result[number] = np.abs(np.sum(amplitude * phase * (range_m / away_m) ** 2)) ** 2
    return result
