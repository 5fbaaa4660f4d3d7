"""What surveys in a row do once: preparing a survey, and studies over one terrain."""

from collections.abc import Iterator
from time import perf_counter

from sionna_radar.scenario import load_scenario
from sionna_radar.studies.ratio import Ratio
from sionna_radar.survey.chain import run
from sionna_radar.survey.preparation import prepare

REUSE_RATIOS = 3
# What every survey of a study has to do itself.
OWN_STAGES = ("trace", "synthesise", "detect", "map")


def measure_reuse(cells: int, length_m: float) -> Iterator[Ratio]:
    """Yield how long `hills` takes to prepare, and what a study over it costs beside its surveys' own stages."""
    prepare(load_scenario("hills")).build_sensor()
    # Another terrain each time, so that nothing of the last one serves again.
    anew = min(_preparation_s({"terrain.seed": 2 + trial}) for trial in range(3))
    again = min(_preparation_s({"terrain.seed": 4, "seed": 2 + trial}) for trial in range(3))
    yield Ratio(name="seconds to prepare hills", value=anew, bound=0.35, at_most=True)
    yield Ratio(name="seconds to prepare hills over the same terrain", value=again, bound=None, at_most=True)
    yield study_over_stages(cells, length_m)


def study_over_stages(cells: int, length_m: float) -> Ratio:
    """Return the time of a study over one terrain, over that of all its traces, syntheses, detections and maps."""
    spent = taken = 0.0
    for cell in range(cells + 1):
        changes = {
            "seed": 1 + cell,
            "radar.snr_db": 20.0 + cell % 5,
            "processing.window": ("hann", "taylor")[cell % 2],
            "platform.length_m": length_m,
        }
        start = perf_counter()
        survey = run(load_scenario("hills", changes))
        if cell:  # the first one builds the scene, which a study of many has long forgotten
            taken += perf_counter() - start
            spent += sum(survey.timing_s[stage] for stage in OWN_STAGES)
    name = f"study of {cells} surveys over one terrain / its traces to maps"
    return Ratio(name=name, value=taken / spent, bound=1.2, at_most=True)


def _preparation_s(changes: dict[str, object]) -> float:
    start = perf_counter()
    prepare(load_scenario("hills", changes)).build_sensor()
    return perf_counter() - start
