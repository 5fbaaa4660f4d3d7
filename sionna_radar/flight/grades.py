"""Named grades of GPS/IMU, with the sources of their numbers.

Every quantity is a standard deviation and is taken as a first-order Gauss-Markov error, since a filter's output
drifts and does not jump. Basis of each number:

- First-hand, the maker's claim, untested: position, velocity and heading of the "consumer" and "rtk" grades (Blicube's
  specifications of its GRTK, RMS).
- First-hand, the maker's test, but no truth: position of the "survey" grade. It is the RMS difference between two
  post-processed solutions (PP-RTX against SmartBase, 100 data sets), the better of which is believed accurate to
  1-2 cm horizontally and 2-4 cm in height; common systematic errors do not show, and a real-time solution does not
  reach this.
- Second-hand: roll and pitch of "rtk" (the maker's claim, as listed by a user). Roll and pitch of "survey"
  are from a trade journal's report on sensors aboard a ship; an aircraft moves differently.
- From notes, the source itself not at hand when this was written: attitude of "consumer" (datasheet), and the figures
  of the trade journal.
- Our assumptions: the type of process and its correlation times, those of `NavigationTable`, which no source gives;
  that a horizontal figure combines both axes, hence each is 1 / sqrt(2) of it, and that a velocity applies to
  every axis; that the heading error of two antennas is inverse to their distance; that "survey" measures velocity no
  better than GRTK. The part of an RTK position that grows with the distance to its base, 1 mm per km, is left out.
"""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from sionna_radar.foundation.errors import InputFileError, RadarError, ScenarioError
from sionna_radar.foundation.input_file import parse_toml, read_text
from sionna_radar.scenario.navigation import NavigationTable
from sionna_radar.scenario.problems import translate

GRTK = "Blicube GRTK, the manufacturer's performance specifications (github.com/blikvm/ardupilot_rtk)"


@dataclass(frozen=True, kw_only=True)
class Grade:
    """A grade of GPS/IMU: its errors, and the source of the numbers."""

    errors: NavigationTable
    source: str


GRADES = {
    # 1.5 m horizontal and 2.5 m vertical RMS of a single-point fix, 0.03 m/s; attitude 0.4 deg, heading 1.0 deg.
    "consumer": Grade(
        errors=NavigationTable(
            position_markov_m=(1.06, 1.06, 2.5), velocity_markov_mps=0.03, attitude_markov_deg=(0.4, 0.4, 1.0)
        ),
        source=(
            f"position, velocity: {GRTK}, single point; attitude: Moog Crossbow NAV440 datasheet rev. B, from notes"
        ),
    ),
    # 1 cm + 1 ppm horizontal and 1.5 cm + 1 ppm vertical, heading 0.2 deg over 1 m; roll and pitch in motion 0.5 deg.
    "rtk": Grade(
        errors=NavigationTable(
            position_markov_m=(0.007, 0.007, 0.015), velocity_markov_mps=0.03, attitude_markov_deg=(0.5, 0.5, 0.2)
        ),
        source=(
            f"position, velocity, heading: {GRTK}, RTK, antennas 1 m apart; roll, pitch: Xsens MTi-30 in motion, "
            "second-hand, as listed by github.com/deepguider/dg_cart_ros"
        ),
    ),
    # North 0.021, east 0.020, down 0.056 m RMS over 100 data sets; roll and pitch 0.01 to 0.025 deg at moderate rates.
    "survey": Grade(
        errors=NavigationTable(
            position_markov_m=(0.020, 0.021, 0.056),
            velocity_markov_mps=0.03,
            attitude_markov_deg=(0.025, 0.025, 0.1),
        ),
        source=(
            "position: Applanix POSPac PP-RTX, airborne accuracy assessment, table 1 (differences between two "
            "post-processed solutions); roll, pitch: Hydro International, motion sensor performance (five sensors "
            f"side by side on a ship), from notes; velocity, heading: {GRTK}, heading scaled to antennas 2 m apart"
        ),
    ),
}


def load_grades(path: Path) -> dict[str, Grade]:
    """Read grades from a TOML file: one table each, with the keys of [platform.navigation] and a `source`.

    Raises
    ------
    InputFileError
        The file is missing or not TOML, or a table is wrong.

    """
    text = read_text(path, "grades", "give a TOML file of [name] tables of platform.navigation keys")
    try:
        tables = parse_toml(text)
        return {
            name: Grade(
                source=str(table.get("source", path)),
                errors=_errors(path, name, {key: v for key, v in table.items() if key != "source"}),
            )
            for name, table in tables.items()
        }
    except RadarError:
        raise
    except (ValueError, AttributeError) as error:
        message = f"{path}: not a table of navigation grades ({error}); give [name] tables of platform.navigation keys"
        raise InputFileError(message) from error


def _errors(path: Path, name: str, table: dict[str, Any]) -> NavigationTable:
    try:
        return NavigationTable.model_validate(table)
    except ValidationError as error:
        problems = [replace(p, field=f"{name}.{p.field}") for p in translate(error.errors(), NavigationTable)]
        message = str(ScenarioError(problems, f"{path}: not a table of navigation grades"))
        raise InputFileError(message) from error
