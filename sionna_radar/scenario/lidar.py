"""The ideal range sensor that a radar is compared with: `[lidar]`."""

from sionna_radar.scenario.table import NonNegative, Table


class LidarTable(Table):
    """An ideal range sensor on the radar's scan: the exact range along the beam axis, with white noise."""

    range_noise_m: NonNegative = 0.0
