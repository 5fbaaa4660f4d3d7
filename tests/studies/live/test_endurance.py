"""An hour in the loop: 72,000 steps at 20 Hz take no more memory than the first minutes."""

import gc
import os
from pathlib import Path
from statistics import median, quantiles
from time import perf_counter

import numpy as np
import pytest

from sionna_radar.scenario import load_scenario
from sionna_radar.studies.live.live_map import LiveMap
from sionna_radar.studies.live.radar import Radar

STEPS = int(os.environ.get("SIONNA_RADAR_STEPS", "72000"))
KEYS = {
    "radar.chirp_rate_hz": 80.0,
    "radar.scan.rotation_rpm": 60.0,
    "radar.scan.half_swath_deg": 60.0,
    "tracing.paths_per_pulse": 64,
    "platform.length_m": 100.0,
    "platform.navigation.position_markov_m": [0.1, 0.1, 0.1],
}


def resident_mb():
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 2**20


@pytest.mark.study
def test_an_hour_takes_no_more_than_the_first_minutes(tmp_path):
    radar = Radar(load_scenario("hills", KEYS))
    radar.warm_up()
    live = LiveMap(radar, tmp_path / "live", window_m=40.0, echoes_in_memory=2000)
    held_mb, adds_s, pulses = [], [], 0
    collections = []
    gc.callbacks.append(lambda phase, info: collections.append(info["generation"]) if phase == "start" else None)
    for step in range(STEPS):
        # To and fro over a hundred metres at 10 m/s.
        way_m = step * 0.5 % 200.0
        east_m = -100.0 + min(way_m, 200.0 - way_m)
        heading = np.pi / 2 if way_m < 100.0 else -np.pi / 2
        frame = radar.step(step / 20.0, (east_m, 0.0, 60.0), (0.0, 0.0, heading))
        began_s = perf_counter()
        live.add(frame)
        adds_s.append(perf_counter() - began_s)
        pulses += len(frame)
        if step % (STEPS // 60) == 0:
            held_mb.append(resident_mb())
    gc.callbacks.clear()
    early, late = median(held_mb[4:10]), median(held_mb[-6:])
    minute = STEPS // 60
    # Most frames of this radar hear nothing: it looks aside two thirds of each turn.
    first_ms, last_ms = (1e3 * quantiles(part, n=10)[-1] for part in (adds_s[minute : 2 * minute], adds_s[-minute:]))
    print(
        f"{pulses:,} pulses, memory {early:.0f} -> {late:.0f} MB, 90 % of the adds of the second and of the last "
        f"minute within {first_ms:.2f} -> {last_ms:.2f} ms, {len(collections)} collections, "
        f"{collections.count(2)} of them full"
    )
    assert pulses > STEPS
    assert late < early + 20.0
    assert last_ms < 2.0 * first_ms
