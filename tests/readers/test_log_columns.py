"""CSV of other programs: columns by known names or a map, delimiters, decimal commas, dates, feet, milliseconds."""

from datetime import UTC, datetime

import numpy as np
import pytest

from flight_logs import flown, regular, write_csv
from sionna_radar import load_scenario
from sionna_radar.flight.log import in_metres
from sionna_radar.flight.log_cleaning import clean, stretches
from sionna_radar.foundation.errors import InputFileError, ScenarioError
from sionna_radar.readers.logs.reader import read_log
from sionna_radar.studies.log.study import inspect_log

FLIGHT = flown(regular(10.0, 5.0))
START = datetime(2024, 5, 1, 12, tzinfo=UTC).timestamp()
ROLL, PITCH, HEADING = np.rad2deg(FLIGHT.euler).T
LON, LAT, HEIGHT = FLIGHT.degrees.T


def dates(form):
    return [datetime.fromtimestamp(START + t, UTC).strftime(form) for t in FLIGHT.time_s]


def numbers(values, comma="."):
    return [f"{value:.9f}".replace(".", comma) for value in values]


def text(columns, delimiter):
    return "\n".join([delimiter.join(columns), *(delimiter.join(row) for row in zip(*columns.values(), strict=True))])


FILES = {
    "semicolons and decimal commas": text(
        {
            "Timestamp": numbers(FLIGHT.time_s, ","), "Latitude": numbers(LAT, ","), "Longitude": numbers(LON, ","),
            "Altitude": numbers(HEIGHT, ","), "Name": ["a"] * len(LAT),
        }, ";",
    ),
    "AirData UAV, in feet": text(
        {
            "time(millisecond)": numbers(1000 * FLIGHT.time_s), "datetime(utc)": dates("%Y-%m-%d %H:%M:%S"),
            "latitude": numbers(LAT), "longitude": numbers(LON), "height_above_takeoff(feet)": numbers(HEIGHT - 400),
            "altitude_above_seaLevel(feet)": numbers(HEIGHT / 0.3048), " compass_heading(degrees)": numbers(HEADING),
            " pitch(degrees)": numbers(PITCH), " roll(degrees)": numbers(ROLL),
        }, ",",
    ),
    "QGroundControl": text(
        {
            "Timestamp": dates("%Y-%m-%d %H:%M:%S.%f"), "roll": numbers(ROLL), "pitch": numbers(PITCH),
            "heading": numbers(HEADING), "groundSpeed": ["--.--"] * len(LAT), "altitudeAMSL": numbers(HEIGHT),
            "gps.lat": numbers(LAT), "gps.lon": numbers(LON),
        }, ",",
    ),
    "milliseconds since 1970, tabs": text(
        {
            "timestamp": [f"{1000 * (START + t):.3f}" for t in FLIGHT.time_s], "lat": numbers(LAT), "lng": numbers(LON),
            "alt": numbers(HEIGHT),
        }, "\t",
    ),
}  # fmt: skip


@pytest.mark.parametrize("program", FILES)
def test_exports_of_other_programs_are_the_flight_that_they_are_of(program, tmp_path):
    path = tmp_path / "a.csv"
    path.write_text(FILES[program], encoding="utf-8")
    log = read_log(path)
    assert log.on_map
    np.testing.assert_allclose(log.positions.time_s, FLIGHT.time_s, atol=1e-3)
    np.testing.assert_allclose(log.positions.place, FLIGHT.degrees, rtol=0, atol=1e-6)
    (read,) = (note for note in log.notes if note.startswith("columns read: "))
    assert all(f"' as {key}" in read for key in ("lon_deg", "lat_deg"))
    if "roll" in FILES[program]:
        expected = read_log(write_csv(tmp_path / "b.csv", FLIGHT)).attitudes.quaternion
        np.testing.assert_allclose(np.abs(np.sum(log.attitudes.quaternion * expected, axis=1)), 1.0, atol=1e-9)
    else:
        assert log.attitudes is None


def test_a_map_of_columns_reads_any_names(tmp_path):
    path = tmp_path / "a.csv"
    columns = {"Zeit": FLIGHT.time_s, "Ost": FLIGHT.place[:, 0], "Nord": FLIGHT.place[:, 1], "Höhe": FLIGHT.place[:, 2]}
    path.write_text(text({name: numbers(values, ",") for name, values in columns.items()}, ";"), encoding="utf-8")
    named = {"time_s": "Zeit", "east_m": "Ost", "north_m": "Nord", "up_m": "Höhe"}
    with pytest.raises(InputFileError, match=r"unrecognised CSV header; .* or say by platform.log_columns"):
        read_log(path)
    np.testing.assert_allclose(read_log(path, "log", named).positions.place, FLIGHT.place, atol=1e-6)
    for wrong, says in (
        (
            named | {"up_m": "Hoehe"},
            r"line 1 'Zeit;Ost;Nord;Höhe': has no column 'Hoehe', which .*columns.up_m names",
        ),
        (named | {"upward_m": "Höhe"}, "upward_m is no column of a flight; give one of"),
    ):
        with pytest.raises(InputFileError, match=says):
            read_log(path, "log", wrong)
    scenario = load_scenario("hills", {"platform": {"log": str(path), "log_columns": named}})
    assert scenario.platform.log_columns == named
    with pytest.raises(ScenarioError, match=r"log_columns: has no effect without platform\.log"):
        load_scenario("hills", {"platform.log_columns": named})


def test_the_stretches_between_what_is_refused_can_be_flown(tmp_path):
    """A gap at 6 s, a jump at 12 s, and standing still from 18 s on."""
    flight = flown(regular(20.0, 24.0))
    time_s, place = flight.time_s.copy(), flight.place.copy()
    place[(time_s > 12)] += [60.0, 0.0, 0.0]
    place[time_s > 18] = place[time_s > 18][0]
    time_s[time_s > 6] += 5.0
    columns = {"time_s": time_s, "east_m": place[:, 0], "north_m": place[:, 1], "up_m": place[:, 2]}
    path = tmp_path / "a.csv"
    path.write_text(text({name: numbers(values) for name, values in columns.items()}, ","))
    found = inspect_log(path)
    assert found.refusals
    np.testing.assert_allclose(found.stretches, [(0.0, 6.0), (11.05, 17.0), (17.05, 29.0)], atol=0.06)
    metric = in_metres(read_log(path))
    assert all(not clean(metric, *ends, 2.0).findings for ends in found.stretches)
    assert stretches(metric, 0.0, np.inf, 10.0)[0][1] > 12.0
    whole = inspect_log(write_csv(tmp_path / "b.csv", FLIGHT))
    assert whole.stretches == ((0.0, 5.0),)
