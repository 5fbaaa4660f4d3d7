"""Rows of theta, phi and power, in any order, brought into a grid."""

import numpy as np
from jaxtyping import Float

from sionna_radar.radar.pattern_files.contents import FLOOR_DB, PatternGrid, check_levels

# Angles in files are rounded; closer ones are the same.
SAME_DEG = 1e-4


def grid_of(
    theta_deg: Float[np.ndarray, " n"], phi_deg: Float[np.ndarray, " n"], power_db: Float[np.ndarray, " n"]
) -> PatternGrid:
    """Return the grid of rows of angles and power.

    Negative thetas lie on the other side of the axis; phis repeat every 360 degrees.

    Raises
    ------
    ValueError
        The rows fill no grid.

    """
    if np.any(np.abs(theta_deg) > 180 + SAME_DEG) or np.any(np.abs(phi_deg) > 720):
        message = "theta beyond 180 deg or phi beyond 720 deg; give angles in degrees"
        raise ValueError(message)
    check_levels(power_db)
    theta, phi = np.abs(theta_deg), np.where(theta_deg < 0, phi_deg + 180, phi_deg) % 360
    phi[360 - phi < SAME_DEG] = 0.0
    thetas, row = _levels(theta)
    phis, column = _levels(phi)
    power = np.full((len(thetas), len(phis)), -np.inf)
    known = np.zeros(power.shape, dtype=bool)
    power[row, column] = np.maximum(power_db, FLOOR_DB + power_db.max())
    known[row, column] = True
    for pole in (0.0, 180.0):  # all phis meet there: one of them is enough
        at = np.flatnonzero(np.abs(thetas - pole) < SAME_DEG)
        if len(at) and known[at[0]].any():
            power[at[0], ~known[at[0]]] = power[at[0], known[at[0]]].max()
            known[at[0]] = True
    if len(thetas) < 2 or len(phis) < 2 or not known.all():
        message = (
            f"{np.count_nonzero(~known):,} of the {known.size:,} directions of its {len(thetas):,} thetas and "
            f"{len(phis):,} phis are missing; give every pair of at least two of each"
        )
        raise ValueError(message)
    if phis[0] + 360 - phis[-1] <= 1.5 * np.diff(phis).max():  # all around
        phis, power = np.append(phis, phis[0] + 360), np.column_stack([power, power[:, 0]])
    if phis[0] > SAME_DEG and phis[-1] > 360:
        # The first phi need not be 0: another turn behind it covers what lies before it.
        phis, power = np.append(phis[-2] - 360, phis[:-1]), np.column_stack([power[:, -2], power[:, :-1]])
        phis, power = np.append(phis, phis[1] + 360), np.column_stack([power, power[:, 1]])
    return PatternGrid(thetas, phis, power - power.max())


def _levels(angle_deg: Float[np.ndarray, " n"]) -> tuple[Float[np.ndarray, " level"], np.ndarray]:
    """Return the different angles, and which of them each is."""
    order = np.sort(angle_deg)
    levels = order[np.concatenate([[True], np.diff(order) > SAME_DEG])]
    index = np.clip(np.searchsorted(levels, angle_deg - SAME_DEG), 0, len(levels) - 1)
    return levels, index
