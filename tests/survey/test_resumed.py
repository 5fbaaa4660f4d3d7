"""A survey that is interrupted goes on, flies nothing twice, and gives what it would have given at once."""

import os
import shutil
import signal
import subprocess
import sys
import time

import numpy as np
import pytest

from sionna_radar.execution.checkpoints import FOLDER, open_checkpoints
from sionna_radar.execution.execution import Execution
from sionna_radar.foundation.columns import packed
from sionna_radar.scenario import load_scenario
from sionna_radar.scenario.loading import identity
from sionna_radar.survey.chain import run
from sionna_radar.survey.observation import SegmentObserver, _segment_and_counts, observe
from sionna_radar.survey.preparation import prepare

SHORT = {"platform.length_m": 24.0, "terrain.spacing_m": 2.0, "tracing.paths_per_pulse": 48}
BLOCK = 12


class Stop(BaseException):
    """An interrupt."""


@pytest.mark.parametrize(
    ("scene", "changes"),
    [
        ("hills", {}),
        ("hills", {"dem.method": "smooth"}),
        pytest.param("rain", {"weather.rain_rate_mm_per_h": 10.0, "dem.method": "smooth"}, marks=pytest.mark.study),
        ("rain", {"weather.rain_rate_mm_per_h": 10.0, "processing.volume_clutter": "off"}),
    ],
)
def test_an_interrupted_survey_goes_on(scene, changes, tmp_path, monkeypatch):
    monkeypatch.setattr("sionna_radar.survey.observation.SEGMENT_BLOCKS", 2)
    scenario = load_scenario(scene, SHORT | changes)
    prepared = prepare(scenario)
    whole = run(prepared, execution=Execution(block_size=BLOCK))
    flown = []
    observed = SegmentObserver._counted

    def counted(self, block):
        flown.append(block.pulses.index)
        if len(flown) % 3 == 0:
            raise Stop
        return observed(self, block)

    monkeypatch.setattr(SegmentObserver, "_counted", counted)
    interrupts = 0
    while True:
        try:
            with open_checkpoints(tmp_path / "out", identity(scenario, BLOCK), resume=True) as parts:
                again = run(prepared, execution=Execution(block_size=BLOCK, checkpoints=parts))
                break
        except Stop:
            interrupts += 1
    assert interrupts >= 2
    # An interrupt costs no more than the blocks of the segment that it hit.
    assert len(flown) <= len(list(prepared.flight.line_bounds(BLOCK))) + 2 * interrupts
    assert again.points.sha256() == whole.points.sha256()
    assert repr((again.paths, again.warnings, again.lit_error)) == repr((whole.paths, whole.warnings, whole.lit_error))
    np.testing.assert_array_equal(again.lit, whole.lit)
    np.testing.assert_array_equal(again.dem.height_m, whole.dem.height_m)
    assert not (tmp_path / "out" / FOLDER).exists()


def test_a_segment_is_its_bytes(tmp_path, monkeypatch):
    monkeypatch.setattr("sionna_radar.survey.observation.SEGMENT_BLOCKS", 100)
    rain = {"weather.rain_rate_mm_per_h": 10.0, "dem.method": "smooth", "platform.length_m": 8.0}
    scenario = load_scenario("rain", SHORT | rain)
    prepared, kept = prepare(scenario), []
    with open_checkpoints(tmp_path / "out", {}, resume=False) as parts:
        monkeypatch.setattr(type(parts), "put", lambda self, key, content: kept.append(content))
        observe(prepared, Execution(checkpoints=parts))
    seen, counted = _segment_and_counts(kept[0])
    assert packed(seen=seen, counted=counted) == kept[0]
    assert seen.profiles.volume is not None
    assert len(seen.echoes) > 50
    assert counted.paths > 1000


@pytest.mark.study
@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="there is no SIGKILL")
def test_a_survey_killed_at_random_moments_ends_as_if_it_had_not_been(tmp_path):
    """Killed 20 times by SIGKILL: `pytest -m study -k killed`, two minutes."""
    command = [
        sys.executable,
        "-m",
        "sionna_radar",
        "run",
        "hills",
        "--block-size",
        "30",
        "-q",
        "--no-report",
        "--resume",
    ]
    subprocess.run([*command, "-o", tmp_path / "whole"], check=True)
    rng, kills = np.random.default_rng(1), 0
    began = time.monotonic()
    subprocess.run([*command, "-o", tmp_path / "timed"], check=True)
    takes_s = time.monotonic() - began
    while kills < 20:
        process = subprocess.Popen([*command, "-o", tmp_path / "out"])
        try:
            process.wait(rng.uniform(0.3, 1.0) * takes_s)
        except subprocess.TimeoutExpired:
            os.kill(process.pid, signal.SIGKILL)
        if process.wait() == 0:
            # A finished result would be flown no more.
            shutil.rmtree(tmp_path / "out")
        else:
            kills += 1
    subprocess.run([*command, "-o", tmp_path / "out"], check=True)
    names = {path.relative_to(tmp_path / "whole") for path in (tmp_path / "whole").rglob("*") if path.is_file()}
    assert {path.relative_to(tmp_path / "out") for path in (tmp_path / "out").rglob("*") if path.is_file()} == names
    for name in names:
        if name.name != "costs.json":
            assert (tmp_path / "out" / name).read_bytes() == (tmp_path / "whole" / name).read_bytes(), name
