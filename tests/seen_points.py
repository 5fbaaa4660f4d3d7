"""Located echoes of given places."""

import numpy as np

from sionna_radar.mapping.points import Points


def seen_points(position_m: np.ndarray, origin_m: object = (0.0, 0.0, 100.0), **columns: np.ndarray) -> Points:
    """Return points of a pulse each, seen from an origin each or from one, with other columns where given."""
    position_m = np.asarray(position_m, dtype=float)
    count = len(position_m)
    origin_m = np.broadcast_to(origin_m, (count, 3)).astype(float)
    usual = {
        "pulse": np.arange(count),
        "number": np.zeros(count, dtype=np.int64),
        "range_m": np.linalg.norm(position_m - origin_m, axis=1),
        "range_sigma_m": np.full(count, 0.1),
        "power": np.ones(count),
        "echo_snr_db": np.full(count, 30.0),
    }
    return Points(position_m=position_m, origin_m=origin_m, **(usual | columns))
