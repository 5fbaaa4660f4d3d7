"""Range and range rate from the two halves of a triangular sweep, with no other knowledge of the velocity.

Motion shifts the echo of an up-sweep one way and that of a down-sweep the other: the mean of both is the range,
their difference the range rate (Rouveure et al. 2017, eq. 2, twice).
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from sionna_radar.detection.echoes import Echoes
from sionna_radar.radar.chirp import Chirp


@dataclass(frozen=True, kw_only=True)
class PairedEchoes:
    """Echoes of pairs of sweeps, with ranges free of Doppler shift, and the range rate of each."""

    echoes: Echoes
    range_rate_mps: Float[np.ndarray, " echo"]


def pair_sweeps(up: Echoes, down: Echoes, chirp: Chirp) -> PairedEchoes:
    """Combine the echoes of the rising and the falling halves.

    Parameters
    ----------
    up, down:
        At most one echo per pulse, not corrected for Doppler; a pulse without both is dropped.
    chirp:
        The rising half.

    """
    pulse, first, second = np.intersect1d(up.pulse, down.pulse, return_indices=True)
    early, late = up.range_m[first], down.range_m[second]
    # The halves are one sweep duration apart, and the range changes in between.
    slope = 2 * float(chirp.doppler_range_m(np.ones(1))[0]) - chirp.duration_s
    snr = [10 ** (echoes.snr_db[rows] / 10) for echoes, rows in ((up, first), (down, second))]
    echoes = Echoes(
        pulse=pulse,
        number=np.zeros(len(pulse), dtype=np.int64),
        range_m=(early + late) / 2,
        range_sigma_m=np.hypot(up.range_sigma_m[first], down.range_sigma_m[second]) / 2,
        power=(up.power[first] + down.power[second]) / 2,
        snr_db=10 * np.log10((snr[0] + snr[1]) / 2),
    )
    return PairedEchoes(echoes=echoes, range_rate_mps=(early - late) / slope)
