"""The ratio of a study over one terrain: measured, and of surveys that share their scene."""

import pytest

import benchmark_cases


def test_a_study_shares_its_scene(monkeypatch: pytest.MonkeyPatch) -> None:
    casters = set()
    flown = benchmark_cases.run

    def run(scenario):
        survey = flown(scenario)
        casters.add(id(survey.prepared.world.caster))
        return survey

    monkeypatch.setattr(benchmark_cases, "run", run)
    ratio = benchmark_cases.study_over_stages(2, 4.0)
    assert len(casters) == 1
    assert ratio.value > 1
    assert ratio.bound == 1.2
