"""Fly a small drone toward an obstacle, and stop before it by the radar's OBSTACLE_DISTANCE alone.

Two processes that speak MAVLink: the radar,

    sionna-radar live examples/obstacle.toml --mavlink udp:127.0.0.1:14550 --clearance 12

and the vehicle, JSBSim's model of the F450 quadcopter under the controller below,

    python examples/stop_before_obstacle.py udpout:127.0.0.1:14550

Needs the extra `live`, and jsbsim.
"""

import argparse
import json
import os
import time

import jsbsim
import numpy as np

os.environ["MAVLINK20"] = "1"
from pymavlink import mavutil

FOOT_M, STEP_S, RATE_HZ = 0.3048, 0.004, 20.0
BRAKING_MPS2, KEPT_M = 2.0, 12.0  # deceleration, and distance from the obstacle at which the vehicle is to stop


class Quadcopter:
    """JSBSim's F450, which takes rates and a throttle; velocity, height and heading are controlled here."""

    def __init__(self, height_m):
        self.model = jsbsim.FGFDMExec(None)
        self.model.set_debug_level(0)
        self.model.load_model("F450")
        for key, value in {"h-agl-ft": height_m / FOOT_M, "psi-true-deg": 90.0, "terrain-elevation-ft": 0.0}.items():
            self.model[f"ic/{key}"] = value
        self.model.set_dt(STEP_S)
        self.model.run_ic()
        self.model["propulsion/set-running"] = -1
        self.model["fcs/ScasEngage"] = 1
        self.height_m, self.climb_sum = height_m, 0.0

    @property
    def ned_m(self):
        north, east = (self.model[f"position/distance-from-start-{axis}-mt"] for axis in ("lat", "lon"))
        return np.array(
            [north, np.copysign(east, self.model["position/long-gc-deg"]), -self.model["position/h-agl-ft"] * FOOT_M]
        )

    @property
    def velocity_mps(self):
        return FOOT_M * np.array([self.model[f"velocities/v-{axis}-fps"] for axis in ("north", "east", "down")])

    @property
    def euler_rad(self):
        return np.array([self.model[f"attitude/{angle}-rad"] for angle in ("phi", "theta", "psi")])

    @property
    def rates_rad_s(self):
        return np.array([self.model[f"velocities/{axis}-rad_sec"] for axis in "pqr"])

    def fly(self, seconds, speed_mps):
        """Fly on at a speed toward the east."""
        for _ in range(round(seconds / STEP_S)):
            (north, _, down), (roll, pitch, yaw) = self.ned_m, self.euler_rad
            v_north, v_east, v_down = self.velocity_mps
            tilt = np.clip(0.15 * np.array([v_east - speed_mps, v_north + 0.5 * north]), -0.35, 0.35)
            wanted_climb = np.clip(0.8 * (self.height_m + down), -2.0, 2.0)
            error = wanted_climb + v_down
            self.climb_sum = np.clip(self.climb_sum + error * STEP_S, -4.0, 4.0)
            level = np.cos(roll) * np.cos(pitch)
            self.model["fcs/throttle-cmd-norm"] = np.clip(
                (0.48 + 0.10 * error + 0.04 * self.climb_sum) / level, 0.0, 1.0
            )
            self.model["fcs/elevator-cmd-norm"] = np.clip(4.0 * (tilt[0] - pitch), -1.0, 1.0)
            self.model["fcs/aileron-cmd-norm"] = np.clip(4.0 * (tilt[1] - roll), -1.0, 1.0)
            self.model["fcs/rudder-cmd-norm"] = np.clip(2.0 * (np.pi / 2 - yaw), -1.0, 1.0)
            self.model.run()


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("address", help="where the radar listens, such as udpout:127.0.0.1:14550")
    parser.add_argument("--speed", type=float, default=10.0, help="m/s")
    parser.add_argument(
        "--start", type=float, nargs=3, default=(-100.0, 0.0, 15.0), help="east, north, height above 0, m"
    )
    parser.add_argument("--seconds", type=float, default=60.0, help="most time of flight")
    parser.add_argument(
        "--realtime", action="store_true", help="keep pace with the clock, whether the radar does or not"
    )
    chosen = parser.parse_args()
    link = mavutil.mavlink_connection(chosen.address, source_system=1, dialect="ardupilotmega")
    east_m, north_m, height_m = chosen.start
    vehicle = Quadcopter(height_m)
    # A server answers who has sent something; the radar takes a while to begin.
    for _ in range(240):
        if link.recv_match(type="HEARTBEAT", blocking=True, timeout=0.5) is not None:
            break
        link.mav.heartbeat_send(2, 0, 0, 0, 4)
    else:
        raise SystemExit(f"no radar answers at {chosen.address}; start `sionna-radar live` first")
    nearest_m, seen_s, track, began_s = np.inf, -np.inf, [], time.monotonic()
    for step in range(int(chosen.seconds * RATE_HZ)):
        now_s = step / RATE_HZ
        # Brake so as to come to rest at KEPT_M; without a word from the radar for a second, at once.
        way_m = max(nearest_m - KEPT_M, 0.0)
        silent = step > RATE_HZ and now_s - seen_s > 1.0
        vehicle.fly(1 / RATE_HZ, 0.0 if silent else min(chosen.speed, np.sqrt(2 * BRAKING_MPS2 * way_m)))
        place, velocity = vehicle.ned_m + np.array([north_m, east_m, 0.0]), vehicle.velocity_mps
        roll, pitch, yaw = vehicle.euler_rad
        link.mav.attitude_send(step * 50, roll, pitch, yaw, *vehicle.rates_rad_s)
        link.mav.local_position_ned_send(step * 50, *place, *velocity)
        track.append([now_s, *place, *velocity, nearest_m if np.isfinite(nearest_m) else None])
        until_s = began_s + (step + 1) / RATE_HZ if chosen.realtime else time.monotonic() + 0.5
        while (left_s := until_s - time.monotonic()) > 0:
            answer = link.recv_match(type="OBSTACLE_DISTANCE", blocking=True, timeout=left_s)
            if answer is not None:
                ahead = [cm / 100 for cm in answer.distances if answer.min_distance <= cm <= answer.max_distance]
                nearest_m, seen_s = min(ahead, default=np.inf), answer.time_usec / 1e6
                if not chosen.realtime:
                    break
        if now_s > 5.0 and np.linalg.norm(velocity) < 0.1:
            break
    flown_m = float(np.hypot(track[-1][2] - track[0][2], track[-1][1] - track[0][1]))
    print(json.dumps({"flown_m": flown_m, "place_m": [track[-1][2], track[-1][1], -track[-1][3]], "track": track}))


if __name__ == "__main__":
    main()
