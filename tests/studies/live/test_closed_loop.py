"""A vehicle in a process of its own, which speaks MAVLink alone, stops before what the radar sees."""

import json
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from test_mavlink import free_port

pytest.importorskip("jsbsim")
pytest.importorskip("pymavlink")

EXAMPLES = Path(__file__).parents[3] / "examples"
WALL = "size_m = [60.0, 12.0, 30.0]"
# East of the nearest face, and where the vehicle starts.
OBSTACLES = {"wall": (WALL, 114.0, 80.0), "pole": ("size_m = [0.3, 0.3, 20.0]", 119.85, 80.0)}


@pytest.mark.parametrize("name", OBSTACLES)
def test_it_stops_before_an_obstacle(tmp_path, name):
    size, face_m, start_m = OBSTACLES[name]
    scenario = tmp_path / "obstacle.toml"
    scenario.write_text((EXAMPLES / "obstacle.toml").read_text().replace(WALL, size))
    port = free_port()
    listen = ["--mavlink", f"udp:127.0.0.1:{port}", "--clearance", "12"]
    radar = subprocess.Popen(
        [sys.executable, "-m", "sionna_radar", "live", scenario, "-q", "-o", tmp_path / "live", *listen],
        stderr=subprocess.PIPE,
    )
    try:
        vehicle = [EXAMPLES / "stop_before_obstacle.py", f"udpout:127.0.0.1:{port}", "--start", str(start_m), "0", "15"]
        flown = subprocess.run([sys.executable, *vehicle], stdout=subprocess.PIPE, timeout=300, check=True)
        radar.send_signal(signal.SIGINT)  # sooner than it would end by silence
        _, said = radar.communicate(timeout=120)
    finally:
        radar.kill()
    assert radar.returncode == 0, said
    flight = json.loads(flown.stdout.splitlines()[-1])
    *_, last = flight["track"]
    assert flight["flown_m"] > face_m - start_m - 15.0
    assert 4.0 < face_m - flight["place_m"][0] < 14.0
    assert abs(last[5]) < 0.2
    assert abs(flight["place_m"][2] - 15.0) < 1.0
    numbers = json.loads((tmp_path / "live" / "live.json").read_text())
    assert numbers["messages"]["OBSTACLE_DISTANCE"] > 0.9 * len(flight["track"])
    assert not {"late", "clock set", "of another system"} & numbers["messages"].keys()
