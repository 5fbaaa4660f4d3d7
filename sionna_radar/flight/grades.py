"""Named grades of GPS/IMU, with the sources of their numbers.

Every quantity is a standard deviation and is taken as a first-order Gauss-Markov error, for a filter's output
wanders and does not jump. The sources give no correlation times: those of `NavigationTable` are our assumption.
A horizontal figure that a source gives for both axes together is divided by sqrt(2).
"""

import tomllib
from dataclasses import dataclass
from pathlib import Path

from pydantic import ValidationError

from sionna_radar.errors import InputFileError
from sionna_radar.scenario.navigation import NavigationTable

GRTK = "Blicube GRTK, performance specifications (github.com/blikvm/ardupilot_rtk)"


@dataclass(frozen=True, kw_only=True)
class Grade:
    """A grade of GPS/IMU: its errors, and where the numbers are from."""

    errors: NavigationTable
    source: str


GRADES = {
    # 1.5 m horizontal and 2.5 m vertical RMS of a single-point fix, 0.03 m/s; attitude 0.4 deg, heading 1.0 deg.
    "consumer": Grade(
        errors=NavigationTable(
            position_markov_m=(1.06, 1.06, 2.5), velocity_markov_mps=0.03, attitude_markov_deg=(0.4, 0.4, 1.0)
        ),
        source=f"position, velocity: {GRTK}, single point; attitude: Moog Crossbow NAV440 datasheet rev. B",
    ),
    # 1 cm + 1 ppm horizontal and 1.5 cm + 1 ppm vertical, heading 0.2 deg over 1 m; roll and pitch in motion 0.5 deg.
    "rtk": Grade(
        errors=NavigationTable(
            position_markov_m=(0.007, 0.007, 0.015), velocity_markov_mps=0.03, attitude_markov_deg=(0.5, 0.5, 0.2)
        ),
        source=(
            f"position, velocity, heading: {GRTK}, RTK, antennas 1 m apart; roll, pitch: Xsens MTi-30 in motion, "
            "as quoted by github.com/deepguider/dg_cart_ros"
        ),
    ),
    # 0.021, 0.020 and 0.056 m RMS over 100 flights; roll and pitch 0.01 to 0.025 deg at moderate rates.
    "survey": Grade(
        errors=NavigationTable(
            position_markov_m=(0.020, 0.021, 0.056),
            velocity_markov_mps=0.03,
            attitude_markov_deg=(0.025, 0.025, 0.1),
        ),
        source=(
            "position: Applanix POSPac PP-RTX, airborne accuracy assessment, table 1; roll, pitch: Hydro "
            "International, motion sensor performance (five sensors side by side); velocity, heading: "
            f"{GRTK}, antennas 2 m apart"
        ),
    ),
}


def load_grades(path: Path) -> dict[str, Grade]:
    """Read grades from a TOML file: a table each, with the keys of [platform.navigation] and a `source`.

    Raises
    ------
    InputFileError
        The file is missing, no TOML, or a table is wrong.

    """
    try:
        tables = tomllib.loads(path.read_text(encoding="utf-8"))
        return {
            name: Grade(
                source=str(table.get("source", path)),
                errors=NavigationTable.model_validate({key: v for key, v in table.items() if key != "source"}),
            )
            for name, table in tables.items()
        }
    except (OSError, tomllib.TOMLDecodeError, UnicodeDecodeError, ValidationError, AttributeError) as error:
        message = f"{path}: no table of navigation grades ({error}); give [name] tables of platform.navigation keys"
        raise InputFileError(message) from error
