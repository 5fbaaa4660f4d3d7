"""A flown altimeter over farmland beside its simulation: nineteen of twenty readings within the data sheet's 2 %."""

from pathlib import Path

import numpy as np

from sionna_radar import Raster, load_scenario, prepare
from sionna_radar.survey.custom_parts import CustomParts

LINE = np.load(Path(__file__).parents[2] / "examples" / "data" / "altimeter_trees.npz")
READINGS, CHIRPS, SPACING_M = slice(800, 860), 8, 10.0
ACCURACY = 0.02  # Collins ALT-50A: 2 ft or 2 %


def test_simulated_readings_are_those_of_the_flown_altimeter(tmp_path):
    time_s, radar_m, laser_m, surface_m = (LINE[name][READINGS] for name in ("utc_s", "radar_m", "laser_m", "dtm_m"))
    time_s = time_s - time_s[0]
    east_m = 54.0 * (time_s - time_s[-1] / 2)
    columns = {
        "time_s": time_s,
        "east_m": east_m,
        "north_m": 0 * time_s,
        "up_m": surface_m + laser_m,
        "roll_deg": LINE["roll_deg"][READINGS],
        "pitch_deg": LINE["pitch_deg"][READINGS],
        "heading_deg": 90 + 0 * time_s,
    }
    log, table = tmp_path / "flight.csv", np.column_stack(list(columns.values()))
    np.savetxt(log, table, delimiter=",", header=",".join(columns), comments="")
    posts_m = np.arange(east_m[0] - 400, east_m[-1] + 400, SPACING_M)
    ground = Raster.from_array(np.tile(np.interp(posts_m, east_m, surface_m), (81, 1)), SPACING_M)
    keys = {
        "platform.log": str(log),
        "platform.log_height": "datum",
        "radar": {"preset": "alt_4300", "samples_per_chirp": 1024},
        "tracing.speckle": "per_pulse",
        "processing.ranging": "threshold",
        "processing.average": {"chirps": CHIRPS, "mode": "incoherent"},
        "processing.cfar.kind": "CA",
        "processing.volume_clutter": "off",
        "dem": {"method": "linear", "spacing_m": 25.0},
    }
    prepared = prepare(load_scenario("hills", keys), CustomParts(terrain=ground))
    pulse_s = prepared.flight.pulses(np.arange(len(prepared))).time_s
    nearest = np.unique(np.argmin(np.abs(pulse_s - time_s[:, None]), axis=1))
    echoes = prepared.echoes(nearest)
    assert len(echoes.range_m) == len(time_s)
    assert np.mean(np.abs(echoes.range_m / radar_m - 1) < ACCURACY) > 0.95
