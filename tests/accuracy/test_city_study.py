"""Stated uncertainties of `stepped` maps over cities: `pytest -m study -n 0 -s -k city_study`.

The odds of the other side of a step were chosen on San Francisco and Florence; on Munich, Etoile and boxes none was.
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import pytest
from jaxtyping import Bool, Float

from sionna_radar import load_scenario, run
from sionna_radar.accuracy.uncertainty import calibration

pytestmark = pytest.mark.study


def crossing(city: str, east_m: float, north_m: float, heading_deg: float, seed: int) -> tuple[str, dict[str, object]]:
    """Two crossing lines of 40 m, scanned 1.5 m apart with a beam of 1 deg."""
    lines = {"platform.lines.centre_m": [east_m, north_m], "platform.lines.length_m": 40.0}
    return "san_francisco", {
        "terrain.kind": f"sionna:{city}",
        "platform.heading_deg": heading_deg,
        "seed": seed,
        **lines,
    }


def conical(city: str, east_m: float, north_m: float, heading_deg: float, seed: int) -> tuple[str, dict[str, object]]:
    """A line of 50 m, scanned conically with a beam of 1 deg."""
    line = {"platform.start_m": [east_m, north_m], "platform.length_m": 50.0}
    return "munich", {"terrain.kind": f"sionna:{city}", "platform.heading_deg": heading_deg, "seed": seed, **line}


HALVES = {
    "chosen on: San Francisco": [
        crossing("san_francisco", 300.0, 30.0, 85.0, 11),
        crossing("san_francisco", 100.0, -150.0, 40.0, 12),
        crossing("san_francisco", -200.0, 100.0, 10.0, 13),
    ],
    "chosen on: Florence": [
        crossing("florence", 0.0, 0.0, 20.0, 14),
        crossing("florence", 150.0, 100.0, 70.0, 15),
        conical("florence", -100.0, -50.0, 0.0, 16),
    ],
    "reported: Munich": [
        conical("munich", 150.0, -350.0, 0.0, 21),
        conical("munich", 150.0, -250.0, 0.0, 22),
        crossing("munich", 0.0, 0.0, 30.0, 23),
    ],
    "reported: Etoile": [
        crossing("etoile", 0.0, 0.0, 15.0, 24),
        crossing("etoile", 150.0, 120.0, 60.0, 25),
        conical("etoile", -150.0, -100.0, 45.0, 26),
    ],
    "reported: boxes": [
        *(("buildings", {"seed": seed}) for seed in (31, 32, 33)),
        ("buildings", {"seed": 34, "radar.antenna.beamwidth_deg": 3.0}),
    ],
}
# An error of a step: steps are 1.2 m and more.
GROSS_M = 2.0
CHANCES = (0.0, 0.001, 0.003, 0.01, 0.03, 0.1, 1.0)


@dataclass(frozen=True)
class Cells:
    """The lit cells of some surveys: errors, what the map says of them, and their distances from walls.

    crossed: whether the truth within the cell, of 5 x 5 places, differs by a step.
    """

    error_m: Float[np.ndarray, " cell"]
    sigma_m: Float[np.ndarray, " cell"]
    other_side: Float[np.ndarray, " cell"]
    wall_m: Float[np.ndarray, " cell"]
    crossed: Bool[np.ndarray, " cell"]

    def print_calibration(self, name: str) -> None:
        """Print shares in intervals by class, and of cells stated a probability how many are wrong."""
        classes = {
            "all": self.wall_m >= 0,
            "within a cell of a wall": self.wall_m <= 1,
            "one to two cells": (self.wall_m > 1) & (self.wall_m <= 2),
            "farther": self.wall_m > 2,
            "crossed by a wall": self.crossed,
            "not crossed": ~self.crossed,
        }
        print(name)
        for label, cells in classes.items():
            found = calibration(self.error_m[cells], self.sigma_m[cells])
            inside = " ".join(f"{100 * share:5.1f}" for share in found.coverage.values())
            beyond = 100 * np.mean(np.abs(self.error_m[cells] / self.sigma_m[cells]) > 5)
            print(
                f"  {label:24s} {found.count:6d} inside {inside} %, RMS of z {found.rms_z:5.2f}, "
                f"beyond 5 sigma {beyond:.2f} %, median sigma {np.median(self.sigma_m[cells]):.3f} m"
            )
        for low, high in pairwise(CHANCES):
            cells = (self.other_side > low) & (self.other_side <= high)
            if cells.any():
                stated, wrong = self.other_side[cells].mean(), self.gross[cells].mean()
                print(f"    stated {stated:.4f}: wrong {wrong:.4f} of {cells.sum()}")

    @property
    def gross(self) -> Bool[np.ndarray, " cell"]:
        return np.abs(self.error_m) > GROSS_M


def flown(scene: str, changes: dict[str, object]) -> Cells:
    survey = run(load_scenario(scene, {"dem.method": "stepped"} | changes))
    truth, grid = survey.prepared.truth, survey.dem.grid
    cells = survey.lit & survey.error.filled
    place = grid.centres_m[cells.ravel()]
    aside = (np.arange(5) - 2) / 5 * grid.spacing_m
    top_m = float(truth.world.scene.bounds_m[1, 2]) + 10.0
    within = np.stack([truth.world.caster.from_above(place + np.array([x, y]), top_m) for x in aside for y in aside])
    return Cells(
        error_m=survey.error.height_m[cells],
        sigma_m=survey.dem_sigma.height_m[cells],
        other_side=survey.uncertainty.other_side[cells],
        wall_m=truth.walls.distance_m(place, 20.0),
        crossed=np.ptp(within, axis=0) > GROSS_M,
    )


@pytest.mark.parametrize("half", HALVES)
def test_stepped_maps_state_what_may_be_of_the_other_side(half):
    """RMS of z under 3, 80 % in 95 along walls, and at most 1.5 times as many cells wrong by a step as are stated."""
    parts = [flown(*case) for case in HALVES[half]]
    every = Cells(*(np.concatenate([getattr(part, name) for part in parts]) for name in Cells.__dataclass_fields__))
    every.print_calibration(half)
    z = every.error_m / every.sigma_m
    assert np.sqrt(np.mean(z**2)) < 3
    assert np.mean(np.abs(z) > 5) < 0.012
    assert np.mean(np.abs(z[every.wall_m <= 1]) < 1.96) > 0.8
    assert every.gross.sum() < 1.5 * every.other_side.sum()
