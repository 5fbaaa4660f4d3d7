"""The ratio of a study over one terrain: measured, and of surveys that share their scene."""

import pytest

from sionna_radar.studies import bench_reuse


def test_a_study_shares_its_scene(monkeypatch: pytest.MonkeyPatch) -> None:
    casters = set()
    flown = bench_reuse.run

    def run(scenario):
        survey = flown(scenario)
        casters.add(id(survey.prepared.scene.caster))
        return survey

    monkeypatch.setattr(bench_reuse, "run", run)
    ratio = bench_reuse.study_over_stages(2, 4.0)
    assert len(casters) == 1
    assert ratio.value > 1
    assert ratio.bound == 1.2
