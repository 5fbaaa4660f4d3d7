"""The cross-section of a body from all sides, by physical optics and further reflections between its faces."""

import numpy as np
from jaxtyping import Float
from scipy.constants import speed_of_light

from sionna_radar.foundation.errors import Problem, ScenarioError
from sionna_radar.scenario.objects import TargetMesh
from sionna_radar.scene.body_file import body_of
from sionna_radar.tracing.effects.bouncing_rays import bounced_echoes
from sionna_radar.tracing.effects.physical_optics import Scatterer

# Sine of the elevation above which a direction has no plane of the upward axis.
UPRIGHT = 0.9999


def rcs_m2(scatterer: Scatterer, toward: Float[np.ndarray, "n 3"], range_m: float) -> Float[np.ndarray, " n"]:
    """Return the cross-section seen from a range, in directions from the body (unit vectors in its axes).

    Where it sees itself, of a wave whose field lies in the plane of its upward axis.
    """
    found = np.empty(len(toward))
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
        found[number] = np.abs(np.sum(amplitude * phase * (range_m / away_m) ** 2)) ** 2
    return found


def rcs_of_mesh(
    mesh: TargetMesh,
    carrier_hz: float,
    azimuth_rad: Float[np.ndarray, " azimuth"],
    elevation_rad: Float[np.ndarray, " elevation"],
    range_m: float = 1000.0,
) -> Float[np.ndarray, "elevation azimuth"]:
    """Return the cross-section of a shape from all sides, in square metres, by physical optics.

    Where it sees itself, up to three reflections between its faces add to it, of a wave polarized in the plane of its
    upward axis.

    Parameters
    ----------
    mesh:
        Its file, as in `[[targets]]`.
    carrier_hz:
        Of the radar.
    azimuth_rad, elevation_rad:
        Direction from which it is seen: clockwise from its front, and above its horizon.
    range_m:
        From which it is seen.

    Raises
    ------
    InputFileError, ScenarioError
        The file cannot be used, or is too large for the wavelength; the carrier or the range is no positive number.

    Examples
    --------
    >>> import numpy as np
    >>> import trimesh
    >>> from sionna_radar.scenario import TargetMesh
    >>> _ = trimesh.creation.icosphere(subdivisions=6, radius=0.05).export("ball.ply")
    >>> rcs_m2 = rcs_of_mesh(TargetMesh(path="ball.ply"), 77e9, np.zeros(1), np.zeros(1))
    >>> bool(abs(10 * np.log10(rcs_m2[0, 0] / (np.pi * 0.05**2))) < 1)
    True

    """
    for name, value in {"carrier_hz": carrier_hz, "range_m": range_m}.items():
        if not 0 < value < np.inf:
            raise ScenarioError([Problem(name, f"{value:g} is not positive and finite; give it in SI units")])
    wavelength_m = speed_of_light / carrier_hz
    seen = Scatterer(body_of(mesh, "mesh", wavelength_m), wavelength_m)
    elevation, azimuth = np.meshgrid(elevation_rad, azimuth_rad, indexing="ij")
    level = np.cos(elevation)
    toward = np.stack([level * np.sin(azimuth), level * np.cos(azimuth), np.sin(elevation)], axis=-1)
    found: Float[np.ndarray, "elevation azimuth"] = rcs_m2(seen, toward.reshape(-1, 3), range_m).reshape(azimuth.shape)
    return found
