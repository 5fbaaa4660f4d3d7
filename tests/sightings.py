"""What a radar on its way over a surface sees of it, by brute force."""

import numpy as np

from sionna_radar.detection.echoes import Profiles
from sionna_radar.elevation.heightfield import Heightfield
from sionna_radar.flight.frames import R_WORLD_NED, whisk_broom_from_antenna
from sionna_radar.flight.pulses import Pose
from sionna_radar.inference.echo.beam import beam_nodes
from sionna_radar.inference.echo.likelihood import Sightings
from sionna_radar.radar.antenna import Antenna
from sionna_radar.radar.array_antenna import taylor_cut
from sionna_radar.radar.chirp import Chirp

CELL_M = 0.3
CELLS = 500
CHIRP = Chirp(carrier_hz=77e9, bandwidth_hz=500e6, rate_hz=360.0, samples=1024)


def make_sightings(surface: Heightfield, beamwidth_deg: float = 4.0, seed: int = 5, bright=None) -> Sightings:
    """Look 45 deg forward from lines 5 m apart; each profile is exponential about the mean of 6,000 rays.

    bright: factor on the power of hits at places of the plan and heights; none means one.
    """
    cut = taylor_cut(np.deg2rad(beamwidth_deg), -20.0)
    beam = beam_nodes(Antenna(cut, cut))
    scan, start = (a.ravel() for a in np.meshgrid(np.deg2rad(np.arange(-24, 25, 3.0)), np.arange(0, 41, 5.0)))
    R = R_WORLD_NED @ np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1.0]]) @ whisk_broom_from_antenna(np.pi / 4, scan)
    position = np.column_stack([start, np.zeros_like(start), np.full_like(start, 50.0)])
    pose = Pose(position_m=position, velocity_mps=np.zeros_like(position), R_world_antenna=R)
    rng = np.random.default_rng(seed)
    power = np.zeros((len(scan), CELLS))
    u, v = rng.uniform(-1.2, 1.2, (2, 6_000)) * np.deg2rad(beamwidth_deg)
    share = (cut.at(u) * cut.at(v)) ** 4
    local = np.column_stack([np.sqrt(1 - u**2 - v**2), u, v])
    for row in range(len(scan)):
        hit = surface.first_hit(np.broadcast_to(position[row], local.shape), local @ R[row].T, 300.0)
        met = np.isfinite(hit)
        cell = np.round(hit[met] / CELL_M).astype(int)
        power_of_hit = share[met] / hit[met] ** 2
        if bright is not None:
            power_of_hit *= bright(position[row] + hit[met, None] * (local[met] @ R[row].T))
        mean = np.bincount(cell, power_of_hit, CELLS)[:CELLS]
        power[row] = rng.exponential(size=CELLS) * (1e6 * mean / share.sum() + 1e-6)
    profiles = Profiles(
        pulse=np.arange(len(scan)),
        first=np.zeros(len(scan), dtype=int),
        start=np.arange(len(scan) + 1) * CELLS,
        power=power.ravel().astype(np.float32),
        noise=np.full(len(scan), 1e-6),
        cell_m=CELL_M,
    )
    return Sightings(
        profiles=profiles,
        pose=pose,
        chirp=CHIRP,
        beam=beam,
        response=np.array([0.0, 1.0, 0.0]),
        looks_per_cell=1.0,
        doppler=0.0,
        reach_m=150.0,
    )
