"""
Drift of SLAM over drives in four cities and a village
======================================================

`python examples/slam_drives.py florence` drives a 76 GHz panoramic radar along streets of one of Sionna's cities, or
through a village of houses and garden walls (`village`, `village_50` at 50 km/h), finds its way from the images with
and without loops and with odometry, and prints rows of the table in `docs/panorama.md`. A city takes about ten minutes
and 2 GB. The ways in `data/drives.json` were laid through the middle of streets, without looking at what SLAM makes of
them.
"""

import json
import os
import sys
from pathlib import Path

import numpy as np

from sionna_radar import load_scenario, panorama, slam
from sionna_radar.studies.slam import Odometry, SlamOptions

SMALL = "SIONNA_RADAR_SMALL" in os.environ
DRIVES = json.loads((Path(__file__).parent / "data" / "drives.json").read_text())


VILLAGES = {"village": 8.0, "village_50": 13.9}


def village(speed_mps):
    """Return a drive once around a ring road of 1.3 km and 150 m on, between houses and the walls of their gardens."""
    rng = np.random.default_rng(11)
    bearing = np.linspace(0.0, 2 * np.pi, 10, endpoint=False)
    radius_m = 205.0 + 35.0 * np.sin(3 * bearing) + rng.uniform(-10, 10, 10)
    corners = np.column_stack([radius_m * np.sin(bearing), radius_m * np.cos(bearing)])
    boxes = []
    for start, end in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        length_m = np.linalg.norm(end - start)
        along = (end - start) / length_m
        heading_deg = np.rad2deg(np.arctan2(*along))
        for side in (-1.0, 1.0):
            across = side * np.array([along[1], -along[0]])
            for at in np.arange(18.0, length_m - 12.0, 24.0):
                plot = start + along * (at + rng.uniform(-3, 3))
                house = plot + across * rng.uniform(13, 19)
                size = rng.uniform([8.0, 7.0, 4.5], [14.0, 10.0, 8.0])
                boxes.append((house, size, heading_deg + rng.uniform(-10, 10)))
                # A wall along the road, with a gate beside it, and one between two gardens.
                boxes.append((plot + across * 7.0, (rng.uniform(8, 18), 0.3, rng.uniform(1.0, 1.8)), heading_deg))
                boxes.append((plot + along * 12.0 + across * 19.0, (16.0, 0.3, 1.5), heading_deg + 90))
    return {
        "terrain": {"kind": "flat", "size_m": [800.0, 800.0]},
        "buildings": [
            {"position_m": at.round(2).tolist(), "size_m": np.round(size, 2).tolist(), "heading_deg": float(heading)}
            for at, size, heading in boxes
        ],
        "platform.waypoints_m": np.concatenate([corners, corners[:2]]).round(2).tolist(),
        "platform.turn_radius_m": 25.0,
        "platform.speed_mps": speed_mps,
    }


def city(name):
    drive = DRIVES[name]
    return {
        "terrain": {"kind": f"sionna:{name}"},
        "buildings": (),
        "platform.speed_mps": drive["speed_mps"],
        "platform.turn_radius_m": drive["turn_radius_m"],
        "platform.waypoints_m": drive["waypoints_m"][: 6 if SMALL else None],
    }


def images(name, seed=1):
    world = village(VILLAGES[name]) if name in VILLAGES else city(name)
    radar = {"preset": "navtech_cts350"}
    common = {"fences": (), "poles": (), "radar": radar, "processing.zero_padding": 1, "tracing.paths_per_pulse": 512}
    return panorama(load_scenario("stadium", world | common | {"seed": seed})).images


def odometry(seen):
    """Return an odometer that reads 1 % too much, and a gyroscope with a bias of 0.3 deg/s; both at 160 Hz."""
    every, rng = slice(None, None, 10), np.random.default_rng(5)
    time_s = seen.time_s.ravel()[every]
    heading = np.unwrap((seen.true.bearing_rad - seen.scan_rad).ravel())[every]
    east, north = seen.true.velocity_mps.reshape(-1, 3)[every, :2].T
    speed = 1.01 * (east * np.sin(heading) + north * np.cos(heading))
    return Odometry(
        time_s=time_s,
        speed_mps=speed + rng.normal(0.0, 0.1, len(time_s)),
        yaw_rate_rad_s=np.gradient(heading, time_s) + np.deg2rad(0.3 + rng.normal(0.0, 0.2, len(time_s))),
    )


def print_rows(name):
    seen = images(name)
    print(f"{name}: {len(seen)} turns", flush=True)
    for loops in (False, True):
        for driven in (None, odometry(seen)):
            found = slam(seen, SlamOptions(loops=loops), driven)
            drift = found.drift
            error = np.abs(found.state - found.true_state)[1:, :2] / found.sigma[1:, :2]
            print(
                f"  {'with' if loops else 'no  '} loops, {'images and odometry' if driven else 'images alone':19} "
                f"{100 * drift.translation:.2f} %, {np.rad2deg(100 * drift.rotation_rad_per_m):.2f} deg per 100 m, end "
                f"{drift.end_m:.2f} m off, stated {np.hypot(*found.sigma[-1, :2]):.2f} m; inside 68 %: "
                f"{np.mean(error < 1):.2f}, 95 %: {np.mean(error < 1.96):.2f}",
                flush=True,
            )


if __name__ == "__main__":
    for name in sys.argv[1:] or (["florence"] if SMALL else [*DRIVES, *VILLAGES]):
        print_rows(name)
