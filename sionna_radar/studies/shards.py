"""The shards of a study, flown by the jobs of an array, put together."""

from collections.abc import Sequence
from dataclasses import replace

from sionna_radar.foundation.errors import InputFileError
from sionna_radar.studies.sweep_plan import Shard
from sionna_radar.studies.sweep_result import Case, Sweep


def merge_shards(shards: Sequence[Sweep]) -> Sweep:
    """Return the whole study of which some sweeps are the shards, the same as if it had been flown at once.

    Raises
    ------
    InputFileError
        They are shards of different studies, one is missing or there twice, or one is not a shard.

    """
    first = shards[0]
    found = [Shard.parse(one.shard) for one in shards if one.shard]
    if len(found) < len(shards):
        _refuse("one of the folders holds a whole study, not a shard; leave it out")
    for other, shard in zip(shards[1:], found[1:], strict=True):
        same = (other.source, other.axes, other.repeat) == (first.source, first.axes, first.repeat)
        if not same or [c.scenario for c in other.cases] != [c.scenario for c in first.cases]:
            _refuse(f"shards {found[0]} and {shard} are of different studies; merge those of one")
        if shard.count != found[0].count:
            _refuse(f"shards {found[0]} and {shard} are of different counts; merge those of one study")
    numbers = [shard.number for shard in found]
    twice = sorted({number for number in numbers if numbers.count(number) > 1})
    missing = sorted(set(range(1, found[0].count + 1)) - set(numbers))
    if twice:
        _refuse(f"shard {twice[0]}/{found[0].count} is there twice; name its folder once")
    if missing:
        _refuse(f"shard {', '.join(f'{n}/{found[0].count}' for n in missing)} is missing; name its folder, too")
    cases = [_merged(same) for same in zip(*(one.cases for one in shards), strict=True)]
    return replace(first, cases=tuple(cases), shard="")


def _merged(cases: Sequence[Case]) -> Case:
    trials = sorted((trial for case in cases for trial in case.trials), key=lambda trial: trial.seed)
    reason = next((case.reason for case in cases if case.reason), "")
    return replace(cases[0], trials=tuple(trials), reason=reason)


def _refuse(message: str) -> None:
    raise InputFileError(message)
