"""
Drift of SLAM over drives in four cities
========================================

`python examples/slam_drives.py florence` drives a 76 GHz panoramic radar along streets of one of Sionna's cities (or of
each), finds its way from the images with and without loops, and prints a row of the table in `docs/panorama.md`. A
city takes about ten minutes and 2 GB. The ways in `data/drives.json` were laid through the middle of streets, without
looking at what SLAM makes of them.
"""

import json
import os
import sys
from pathlib import Path

import numpy as np

from sionna_radar import load_scenario, panorama, slam
from sionna_radar.studies.slam import SlamOptions

SMALL = "SIONNA_RADAR_SMALL" in os.environ
DRIVES = json.loads((Path(__file__).parent / "data" / "drives.json").read_text())


def images(city):
    drive = DRIVES[city]
    return panorama(
        load_scenario(
            "stadium",
            {
                "terrain": {"kind": f"sionna:{city}"},
                **dict.fromkeys(("buildings", "fences", "poles"), ()),
                "radar": {"preset": "navtech_cts350"},
                "processing.zero_padding": 1,
                "tracing.paths_per_pulse": 512,
                "platform.speed_mps": drive["speed_mps"],
                "platform.turn_radius_m": drive["turn_radius_m"],
                "platform.waypoints_m": drive["waypoints_m"][: 6 if SMALL else None],
            },
        )
    ).images


def print_row(city):
    seen = images(city)
    print(f"{city:14} {len(seen):5} turns", end="", flush=True)
    for loops in (False, True):
        found = slam(seen, SlamOptions(loops=loops))
        drift = found.drift
        print(
            f"   {'with' if loops else 'without'} loops {100 * drift.translation:.2f} %, "
            f"{np.rad2deg(100 * drift.rotation_rad_per_m):.2f} deg per 100 m, end {drift.end_m:.2f} m off, stated "
            f"{np.hypot(*found.sigma[-1, :2]):.2f} m",
            end="",
            flush=True,
        )
    print()


if __name__ == "__main__":
    for name in sys.argv[1:] or (["florence"] if SMALL else DRIVES):
        print_row(name)
