"""Trajectories in map coordinates: any CRS, HELIOS++'s files, SBET, and a survey's own; and where a vehicle moves."""

from pathlib import Path

import numpy as np
import pytest
from pyproj import CRS, Proj, Transformer
from scipy.spatial.transform import Rotation

import flight_logs
from flight_logs import HEIGHT, csv_text, write_csv, write_sbet
from sionna_radar.flight.log import Positions, in_metres
from sionna_radar.flight.log_cleaning import moving_spans
from sionna_radar.flight.recorded import LogPart, recorded_route
from sionna_radar.foundation.errors import InputFileError, ScenarioError
from sionna_radar.readers.logs.reader import read_log
from sionna_radar.scenario import load_scenario
from sionna_radar.studies.log.study import inspect_log

FLIGHT = flight_logs.flown(flight_logs.regular(10.0))
CRS_NAME = "EPSG:2056"  # Swiss LV95: oblique Mercator


def projected(crs: str = CRS_NAME) -> tuple[np.ndarray, np.ndarray]:
    """Return places in a CRS, and headings from its grid north."""
    to_map = Transformer.from_crs(CRS(4326), CRS(crs), always_xy=True)
    lon, lat, height = FLIGHT.degrees.T
    place = np.column_stack([*to_map.transform(lon, lat), height])
    convergence = np.deg2rad(Proj(crs).get_factors(lon, lat).meridian_convergence)
    return place, FLIGHT.euler[:, 2] - convergence


def assert_is_the_flight(log) -> None:
    """Positions within 2 mm, attitudes within 2e-5 rad: the convergence is that of the flight's middle.

    A change of datum in the plane takes heights to be 0 on either ellipsoid, which leaves 1.3 mm in Switzerland.
    """
    assert log.on_map
    metric = in_metres(log, flight_logs.here())
    np.testing.assert_allclose(metric.positions.place - [0, 0, HEIGHT], FLIGHT.place, atol=2e-3)
    turn = Rotation.from_quat(metric.attitudes.quaternion).inv() * Rotation.from_quat(FLIGHT.quaternion)
    assert turn.magnitude().max() < 2e-5
    if metric.positions.velocity_mps is not None:
        np.testing.assert_allclose(metric.positions.velocity_mps, FLIGHT.velocity, atol=3e-3)


def table(names: str) -> dict[str, np.ndarray]:
    place, heading = projected()
    roll, pitch = np.rad2deg(FLIGHT.euler[:, :2]).T
    columns = (FLIGHT.time_s + 120.0, *place.T, roll, pitch, np.rad2deg(heading))
    return dict(zip(names.split(","), columns, strict=True))


@pytest.mark.parametrize(
    "names",
    ["t,x,y,z,roll,pitch,yaw", "gps_time,Easting,Northing,Elevation,Roll,Pitch,Heading",
     "time_s,easting_m,northing_m,elevation_m,roll_deg,pitch_deg,heading_deg"],
)  # fmt: skip
def test_a_csv_in_map_coordinates_is_the_flight(tmp_path, names):
    path = tmp_path / "a.csv"
    path.write_text(csv_text(table(names)))
    assert_is_the_flight(read_log(path, crs=CRS_NAME))
    with pytest.raises(InputFileError) as refused:
        read_log(path, "platform.log")
    assert f"line 1 {names!r}: unrecognised CSV header" in str(refused.value)
    assert "platform.log_crs" in str(refused.value)


def test_radians_and_velocities_of_the_grid_are_read(tmp_path):
    place, heading = projected()
    turn = FLIGHT.euler[:, 2] - heading
    grid = np.column_stack([
        np.cos(turn) * FLIGHT.velocity[:, 0] - np.sin(turn) * FLIGHT.velocity[:, 1],
        np.sin(turn) * FLIGHT.velocity[:, 0] + np.cos(turn) * FLIGHT.velocity[:, 1],
        FLIGHT.velocity[:, 2],
    ])  # fmt: skip
    columns = {"t": FLIGHT.time_s} | dict(zip("xyz", place.T, strict=True))
    columns |= dict(zip(("roll_rad", "pitch_rad", "yaw_rad"), (*FLIGHT.euler[:, :2].T, heading), strict=True))
    columns |= {f"velocity_{axis}_mps": grid[:, n] for n, axis in enumerate(("east", "north", "up"))}
    path = tmp_path / "a.csv"
    path.write_text(csv_text(columns))
    log = read_log(path, crs=CRS_NAME)
    assert log.positions.velocity_mps is not None
    assert_is_the_flight(log)


def test_feet_of_a_compound_crs_are_metres_afterwards(tmp_path):
    """Virginia, US survey feet in plane and height."""
    path = tmp_path / "a.csv"
    steps = np.arange(30.0)
    columns = {"t": steps, "x": 11_500_000 + 10 * steps, "y": 3_500_000 + 0 * steps, "z": 1000 + 0 * steps}
    path.write_text(csv_text(columns))
    log = in_metres(read_log(path, crs="EPSG:2284+6360"))
    np.testing.assert_allclose(log.positions.place[:, 2], 1000 * 1200 / 3937, rtol=1e-9)
    assert np.ptp(log.positions.place[:, 0]) == pytest.approx(290 * 1200 / 3937, rel=1e-3)


def test_a_helios_trajectory_is_read_by_its_comment(tmp_path):
    columns = table("t,x,y,z,roll,pitch,yaw")
    order = ("t", "roll", "pitch", "yaw", "x", "y", "z")
    rows = np.column_stack([columns[name] for name in order])
    text = "\n".join(", ".join(f"{value:.9f}" for value in row) for row in rows)
    path = tmp_path / "cycle.trj"
    path.write_text('#TIME_COLUMN: 0\n#HEADER: "t", "roll", "pitch", "yaw", "x", "y", "z"\n' + text + "\n")
    assert_is_the_flight(read_log(path, crs=CRS_NAME))
    # As NumPy writes a header; a comment before a header is none.
    path.write_text("# t,roll,pitch,yaw,x,y,z\n" + text + "\n")
    assert_is_the_flight(read_log(path, crs=CRS_NAME))
    path.write_text("# made by hand, today\nt,roll,pitch,yaw,x,y,z\n" + text + "\n1,2,oops,0,0,0,0\n")
    with pytest.raises(InputFileError, match=f"line {len(rows) + 3}: pitch_deg = 'oops' is no number"):
        read_log(path, crs=CRS_NAME)


@pytest.mark.parametrize(("name", "wander"), [("sbet_1.out", 0.0), ("mission.sbet", -0.7)])
def test_an_sbet_is_read_with_its_wander_angle(tmp_path, name, wander):
    log = read_log(write_sbet(tmp_path / name, FLIGHT, wander))
    assert (log.kind, log.datum) == ("SBET", "ellipsoid")
    assert_is_the_flight(log)


def test_an_sbet_that_is_none_is_one_error(tmp_path):
    path = write_sbet(tmp_path / "a.out", FLIGHT)
    path.write_bytes(path.read_bytes()[:-7])
    with pytest.raises(InputFileError, match="no whole records of 136"):
        read_log(path)
    np.full(34, 1e5).tofile(path)
    with pytest.raises(InputFileError, match="record 1 holds no position"):
        read_log(path)
    with pytest.raises(InputFileError, match=r"platform\.log_crs is of columns of one"):
        read_log(write_sbet(tmp_path / "b.out", FLIGHT), crs=CRS_NAME)


@pytest.mark.parametrize(("crs", "words"), [
    ("EPSG:99999999", "log_crs: 'EPSG:99999999' is not a coordinate reference system"),
    ("EPSG:5773", "neither projected nor geographic"),
    ("EPSG:32702", "does not contain the first position"),
])  # fmt: skip
def test_a_crs_that_does_not_fit_is_one_error(tmp_path, crs, words):
    path = tmp_path / "a.csv"
    far = {"t": FLIGHT.time_s} | dict.fromkeys("xyz", 1e12 + 0 * FLIGHT.time_s)
    path.write_text(csv_text(far if words.startswith("does") else table("t,x,y,z,roll,pitch,yaw")))
    with pytest.raises(ScenarioError, match=words):
        read_log(path, crs=crs)


def test_a_surveys_trajectory_flies_over_another_terrain_on_the_map(tmp_path):
    """`trajectory.csv` has local metres and easting, northing: the key says which are meant."""
    place, heading = projected("EPSG:32632")
    columns = {"time_s": FLIGHT.time_s} | dict(zip(("east_m", "north_m", "up_m"), FLIGHT.place.T, strict=True))
    angles = np.rad2deg(np.column_stack([FLIGHT.euler[:, :2], heading]))
    columns |= dict(zip(("roll_deg", "pitch_deg", "heading_deg"), angles.T, strict=True))
    columns |= dict(zip(("easting_m", "northing_m", "elevation_m"), place.T, strict=True))
    columns |= dict(zip(("longitude_deg", "latitude_deg"), FLIGHT.degrees[:, :2].T, strict=True))
    path = tmp_path / "trajectory.csv"
    path.write_text(csv_text(columns))
    assert not read_log(path).on_map
    np.testing.assert_allclose(read_log(path).positions.place, FLIGHT.place, atol=1e-6)
    assert_is_the_flight(read_log(path, crs="EPSG:32632"))
    assert recorded_route(read_log(path, crs="EPSG:32632"), LogPart(path=path), flight_logs.here).log.on_map
    scenario = load_scenario("hills", {"platform": {"log": str(path), "log_crs": "EPSG:32632"}})
    assert scenario.platform.log_crs == "EPSG:32632"
    with pytest.raises(ScenarioError, match=r"log_crs: has no effect without platform\.log"):
        load_scenario("hills", {"platform.log_crs": "EPSG:32632"})


# ------------------------------------------------------------------------------------------ where a vehicle moves


def walk(*phases: tuple[float, float]) -> Positions:
    """Return positions at 5 Hz with GPS noise: stretches of so many seconds at so many metres a second."""
    speed = np.concatenate([np.full(int(5 * seconds), mps) for seconds, mps in phases])
    east = np.concatenate([[0.0], np.cumsum(speed) / 5])
    noise = np.random.default_rng(3).normal(0.0, 0.4, size=(len(east), 3))
    place = noise + np.column_stack([east, 0 * east, 50 + 0 * east])
    return Positions(source="walk", time_s=np.arange(len(east)) / 5, place=place)


@pytest.mark.parametrize(("phases", "moving"), [
    ([(60.0, 0.0), (40.0, 8.0), (30.0, 0.0), (50.0, 3.0)], [(60.0, 100.0), (130.0, 180.0)]),
    ([(45.0, 5.0)], [(0.0, 45.0)]),
    ([(45.0, 1.2)], [(0.0, 45.0)]),
    ([(45.0, 0.0)], []),
    ([(20.0, 6.0), (4.0, 0.0), (20.0, 6.0)], [(0.0, 44.0)]),
])  # fmt: skip
def test_a_vehicle_moves_between_its_rests(phases, moving):
    found = moving_spans(walk(*phases))
    assert len(found) == len(moving)
    # Within what it drives in the 5 m of a rest, and a step.
    slack = 2.0 + 5.0 / min((mps for _, mps in phases if mps), default=1.0)
    np.testing.assert_allclose(np.array(found).reshape(-1, 2), np.array(moving).reshape(-1, 2), atol=slack)


def as_log(path: Path, positions: Positions) -> Path:
    columns = {"time_s": positions.time_s} | dict(zip(("east_m", "north_m", "up_m"), positions.place.T, strict=True))
    path.write_text(csv_text(columns))
    return path


@pytest.mark.usefixtures("undrawn")
def test_log_and_run_agree_on_what_moves(cli, tmp_path):
    path = as_log(tmp_path / "a.csv", walk((70.0, 0.0), (40.0, 6.0), (60.0, 0.0)))
    said = cli("log", path, "-o", tmp_path / "out").stdout
    assert "the whole log can be flown; the vehicle is stationary for" in said
    (span,) = inspect_log(path).moving
    assert f"log_start_s = {span[0]:.2f}, log_stop_s = {span[1]:.2f}" in said
    recorded_route(read_log(path), LogPart(path=path, start_s=span[0], stop_s=span[1]), lambda: None)
    with pytest.raises(InputFileError, match=rf"vehicle stationary, .* from 0\.00 to 50\.00 s; .*: {span[0]:.2f} to "):
        recorded_route(read_log(path), LogPart(path=path, stop_s=50.0), lambda: None)


@pytest.mark.usefixtures("undrawn")
def test_a_log_that_moves_all_the_time_can_be_flown_whole(cli, tmp_path):
    path = write_csv(tmp_path / "a.csv", FLIGHT)
    said = cli("log", path, "-o", tmp_path / "out").stdout
    assert "the whole log can be flown\n" in said
    place = tmp_path / "map.csv"
    place.write_text(csv_text(table("t,x,y,z,roll,pitch,yaw")))
    said = cli("log", place, "--crs", CRS_NAME, "-o", tmp_path / "out2").stdout
    assert "positions are in CH1903+ / LV95, headings count from its grid north" in said


def test_equal_times_are_told_as_such(tmp_path):
    point = '<trkpt lat="47.1" lon="8.2"><ele>500</ele><time>2023-04-01T10:00:00Z</time></trkpt>'
    path = tmp_path / "still.gpx"
    path.write_text(f'<gpx version="1.1" creator="x"><trk><trkseg>{point * 37}</trkseg></trk></gpx>')
    for read in (inspect_log, lambda path: recorded_route(read_log(path), LogPart(path=path), lambda: None)):
        with pytest.raises(InputFileError, match=r"only one distinct time stamp .*of 37 positions"):
            read(path)
