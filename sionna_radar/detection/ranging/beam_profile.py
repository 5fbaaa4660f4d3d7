"""The mean echo of a sloping plane through a beam, and its fit to measured powers.

On a plane whose normal makes the angle t with the boresight, a ray turned by the small angles of sines s in the plane
of incidence and u across it has the range r0 / (sqrt(1 - s^2 - u^2) - s tan t), with the mean square for u^2. The
echo power falls with the square of the range (constant gamma). Over the beam's two-way power along s this gives
the mean echo: its position is the boresight range r0, its width follows from the slope. Powers are exponential about
the mean, so the fit maximises their likelihood, -sum(P / mu + log mu), by Fisher scoring over r0, log tan t and the
level, from the best of a ladder of slopes.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from sionna_radar.foundation.kept_values import KeptValues, Same
from sionna_radar.radar.antenna import Antenna
from sionna_radar.radar.main_lobe import FOLLOWED, lobe_samples

SAMPLES = 65
SLOPES = np.geomspace(0.1, 5.0, 8)
ITERATIONS = 12
MARGIN = 6
# Power outside the main echo from side lobes of the beam and the window, relative to the echo's level.
PEDESTAL = 2e-2


@dataclass(frozen=True)
class BeamProfile:
    """The beam in the plane of incidence, and the window's response.

    sine: sines of the angle from boresight; share: two-way power there, summing to one.
    across: mean square of the sine across the plane of incidence.
    response: power response of the spectrum to a point target, on bins from -half to half.
    """

    sine: Float[np.ndarray, " sample"]
    share: Float[np.ndarray, " sample"]
    across: float
    response: Float[np.ndarray, " bin"]


@dataclass(frozen=True)
class EchoFit:
    """Boresight range in bins and its standard deviation for one look per bin."""

    centre: Float[np.ndarray, " echo"]
    sigma: Float[np.ndarray, " echo"]


# Surveys in a row look through the same antenna.
_LAST = KeptValues(2)


def beam_profile(antenna: Antenna, response: Float[np.ndarray, " bin"]) -> BeamProfile:
    """Return the profile of an antenna's elevation cut, the plane in which a forward-tilted beam is inclined."""
    return _LAST.once((Same(antenna), response.tobytes()), lambda: _profile(antenna, response))


def _profile(antenna: Antenna, response: Float[np.ndarray, " bin"]) -> BeamProfile:
    cut = antenna.elevation
    lobe = cut.cosine[lobe_samples(cut, FOLLOWED)]
    low, high = lobe[0], lobe[-1]
    sine = low + (np.arange(SAMPLES) + 0.5) * (high - low) / SAMPLES
    share = cut.at(sine) ** 4
    other = antenna.azimuth
    across = float(other.voltage**4 @ other.cosine**2 / np.sum(other.voltage**4))
    return BeamProfile(sine, share / share.sum(), across, response / response.sum())


def fit_echo(
    beam: BeamProfile,
    power: Float[np.ndarray, "pulse bin"],
    noise: Float[np.ndarray, "pulse bin"],
    row: Int[np.ndarray, " echo"],
    start: Int[np.ndarray, " echo"],
    stop: Int[np.ndarray, " echo"],
    centroid: Float[np.ndarray, " echo"],
) -> EchoFit:
    """Fit each echo in its span of bins and a margin around it."""
    from sionna_radar.detection.ranging.plane_fit import fit_planes

    centre, sigma = np.empty(len(row)), np.empty(len(row))
    plane = beam.sine, beam.share, beam.across, beam.response, SLOPES, ITERATIONS, MARGIN, PEDESTAL
    fit_planes(*plane, power, noise, row, start, stop, centroid, centre, sigma)
    return EchoFit(centre, sigma)
