"""Recorded flights through the whole chain, and crossing lines that see what one line leaves in shadow."""

import json
import tomllib

import numpy as np
import pytest

from flight_logs import csv_columns, csv_text, flown, regular, write_csv
from sionna_radar.foundation.errors import ScenarioError
from sionna_radar.report.files.contents import strict_json
from sionna_radar.report.survey.summary import summary
from sionna_radar.scenario import load_scenario, parse_scenario, to_toml
from sionna_radar.survey.chain import run
from sionna_radar.survey.preparation import prepare

QUICK = {"terrain": {"kind": "flat", "size_m": [700.0, 700.0]}, "tracing.paths_per_pulse": 32}


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    columns = csv_columns(flown(regular(20.0, 4.0)))
    columns |= {f"sigma_{axis}_m": np.full(81, 0.3) for axis in ("east", "north", "up")}
    path = tmp_path_factory.mktemp("log") / "flight.csv"
    path.write_text(csv_text(columns))
    return path


@pytest.fixture(scope="module")
def survey(log):
    keys = QUICK | {"platform.log": str(log), "platform.navigation": "from_log", "radar.scan.stabilised": False}
    return run(load_scenario("hills", keys))


def test_a_logged_flight_is_surveyed(survey):
    assert survey.pulses == pytest.approx(4 * 360 * 100 / 360, abs=70)  # 100 of 360 deg are in the sector
    pulses = survey.schedule.sample(50)
    np.testing.assert_allclose(pulses.true.position_m, flown(pulses.time_s).place, atol=1e-4)
    assert survey.prepared.plan.flown.altitude_m == pytest.approx(
        np.median(flown(regular(20.0, 4.0)).place[:, 2]), abs=0.2
    )
    # 0.3 m of error in each axis, nearly constant over 4 s: the echoes are that far off, and no more.
    off = np.linalg.norm(pulses.measured.position_m - pulses.true.position_m, axis=1)
    assert 0.05 < off.mean() < 1.5


def test_the_summary_lists_its_sources_and_rates(survey):
    record = json.loads(strict_json(summary(survey)))["flight_log"]
    assert record["format"] == "CSV"
    assert record["sources"][0]["rate_hz"] == pytest.approx(20.0)
    assert record["errors"] == "sigma columns"
    assert record["speed_mps"]["mean"] == pytest.approx(10.0, abs=0.1)
    assert record["heights"].startswith("its heights taken as in the vertical datum")


def test_the_resolved_scenario_flies_the_same_log(survey):
    again = parse_scenario(tomllib.loads(to_toml(survey.scenario)))
    assert again == survey.scenario


def test_blocks_of_a_logged_flight_are_the_same_bits(survey):
    schedule = survey.schedule
    whole, parts = next(schedule.blocks(10_000)), list(schedule.blocks(37))
    for pose in ("true", "measured"):
        joined = np.concatenate([getattr(part, pose).position_m for part in parts])
        np.testing.assert_array_equal(getattr(whole, pose).position_m, joined)


def test_radar_and_log_must_fit(log, tmp_path, monkeypatch):
    monkeypatch.setattr("sionna_radar.survey.limits.MAX_CHIRPS", 30_000_000)
    with pytest.raises(ScenarioError, match=r"platform\.log_stop_s: 4 s of the log take"):
        prepare(load_scenario("hills", QUICK | {"platform.log": str(log), "radar.chirp_rate_hz": 1e7}))
    high = flown(regular(20.0, 4.0))
    high.place[:, 2] += 400.0
    path = write_csv(tmp_path / "high.csv", high)
    with pytest.raises(ScenarioError, match=r"beams (leave the terrain|meet the ground beyond)"):
        prepare(load_scenario("hills", QUICK | {"platform.log": str(path)}))
    with pytest.raises(ScenarioError, match=r"platform\.navigation\.kind: 'from_log' needs platform\.log"):
        prepare(load_scenario("hills", QUICK | {"platform.navigation": "from_log", "platform.length_m": 10.0}))


def test_crossing_lines_reach_what_one_line_leaves_in_shadow():
    """One building 10 m high, seen from 40 m under 45 deg: forward alone it hides 10 m of ground behind it."""
    building = {"position_m": [0.0, 0.0], "size_m": [12.0, 12.0, 10.0]}
    table = {"count": 1, "spacing_m": 30.0, "length_m": 80.0}
    keys = QUICK | {"buildings": [building], "platform.altitude_m": 40.0, "radar.chirp_rate_hz": 40.0}
    reached = []
    for lines in (table, table | {"count": 2, "crossing": True}):
        flown_lines = run(load_scenario("hills", keys | {"platform.lines": lines, "platform.bank_deg": 30.0}))
        x, y = flown_lines.dem.grid.centres_m.T
        about = np.maximum(np.abs(x), np.abs(y)) < 20.0
        reached.append(np.mean(flown_lines.lit.ravel()[about]))
        assert flown_lines.schedule.trajectory.transmits_s is not None
    assert reached[0] < 0.93
    assert reached[1] > reached[0] + 0.05
