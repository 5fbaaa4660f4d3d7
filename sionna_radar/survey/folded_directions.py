"""How well an array tells directions in its beam from those whose range rates fold into the same cell.

Ground of range rate v lies on the cone u.m = -v / |m| about the motion m, and so does, folded once, that of the range
rate v plus the unambiguous span. The channels tell both apart as far as the signals a of a block differ: a cell of
signal-to-noise ratio R favours the true one by R (1 - L) nepers, L = |a'a_f|^2 / |a|^4, and the speckle of several
scatterers in a cell takes more of that the larger L is.
"""

import numpy as np
from jaxtyping import Float

from sionna_radar.radar.mimo_array import MimoArray

# Directions looked at over the half-power beam, along either axis, and about the motion per beam of the array.
LOOKS, STEPS_IN_BEAM = 5, 4


def folded_likeness(
    array: MimoArray,
    half_view_rad: float,
    beamwidths_rad: tuple[float, float],
    velocity_mps: Float[np.ndarray, "3"],
) -> float:
    """Return the greatest L of a direction in the half-power beam and a folded one in view; 0 without any.

    beamwidths_rad: of an element's pattern, along the left and the up axis. velocity_mps: in the antenna's frame.
    """
    speed = float(np.linalg.norm(velocity_mps))
    if not speed > 0:
        return 0.0
    ahead = velocity_mps / speed
    basis = np.linalg.svd(ahead[None])[2][1:]
    size = max(float(array.size_m.max()) / array.wavelength_m, 1.0)
    phi = np.linspace(0.0, 2 * np.pi, int(np.ceil(2 * np.pi * size * STEPS_IN_BEAM)), endpoint=False)
    around = np.column_stack([np.cos(phi), np.sin(phi)]) @ basis
    span, alike = 2 * array.highest_rate_mps, [0.0]
    left, up = (np.sin(width / 2) * np.linspace(-1, 1, LOOKS) for width in beamwidths_rad)
    for y, z in np.column_stack([grid.ravel() for grid in np.meshgrid(left, up)]):
        if y**2 + z**2 > np.sin(half_view_rad) ** 2:
            continue
        direction = np.array([[np.sqrt(1 - y**2 - z**2), y, z]])
        rate_mps = -direction @ velocity_mps
        true = array.steering(direction, rate_mps)[0]
        most = int(np.ceil(2 * speed / span))
        for fold in (rate_mps + span * n for n in range(-most, most + 1) if n):
            if abs(fold[0]) < speed:
                cosine = -fold[0] / speed
                seen = cosine * ahead + np.sqrt(1 - cosine**2) * around
                seen = seen[seen[:, 0] >= np.cos(half_view_rad)]
                match = array.steering(seen, np.full(len(seen), fold[0])).conj() @ true
                alike.append(float(np.max(np.abs(match) ** 2, initial=0.0)) / array.gain**2)
    return max(alike)
