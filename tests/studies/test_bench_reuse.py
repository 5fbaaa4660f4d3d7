"""The ratio of a study over one terrain: measured, and of surveys that share their scene."""

import pytest

from sionna_radar.studies import bench_cases


def test_a_study_shares_its_scene(monkeypatch: pytest.MonkeyPatch) -> None:
    casters = set()
    flown = bench_cases.run

    def run(scenario):
        survey = flown(scenario)
        casters.add(id(survey.prepared.scene.caster))
        return survey

    monkeypatch.setattr(bench_cases, "run", run)
    ratio = bench_cases.study_over_stages(2, 4.0)
    assert len(casters) == 1
    assert ratio.value > 1
    assert ratio.bound == 1.2
