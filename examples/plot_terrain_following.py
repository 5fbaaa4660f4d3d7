"""
Terrain following by the radar's own readings
=============================================

A drone is to fly 15 m over the ground at 10 m/s. It is steered twenty times a second, first by a radar that looks
ahead, stepped in the loop, then by a perfect altimeter that looks straight down, and by the ground itself, known
beforehand. With SIONNA_RADAR_SMALL=1 the flights are short ones. What comes of it over real ground, in rain and over
trees is told in `docs/live.md`.
"""

# %%
import os
from dataclasses import dataclass, field

import numpy as np
from matplotlib.figure import Figure

from sionna_radar import Radar, load_scenario, prepare

SMALL = os.environ.get("SIONNA_RADAR_SMALL") == "1"
HEIGHT_M, SPEED_MPS, STEP_S = 15.0, 10.0, 0.05
LENGTH_M = 40.0 if SMALL else 200.0
RADAR = {
    "platform": {
        "altitude_m": HEIGHT_M, "speed_mps": SPEED_MPS, "height": "terrain_following", "follow_length_m": 20.0,
        "start_m": [-LENGTH_M / 2 - 20.0, 0.0], "length_m": LENGTH_M,
    },
    "radar.bandwidth_hz": 300e6,
    "radar.samples_per_chirp": 512,
    "radar.chirp_rate_hz": 1390.0,
    "radar.antenna.beamwidth_deg": 4.0,
    "radar.scan": {"mode": "conical", "incidence_deg": 58.0, "half_swath_deg": 10.0, "rotation_rpm": 1200.0},
    "tracing.paths_per_pulse": 256,
    "dem.method": "linear",
}  # fmt: skip


# %%
# The vehicle answers a commanded height with a lag of a second, and climbs at 5 m/s at most. The command is the highest
# that any place ahead asks for: its ground and 15 m, less what the vehicle can still climb on the way there.
LAG_S, CLIMB_MPS = 1.0, 5.0
AHEAD_M, ASIDE_M, BIN_M = 30.0, 3.0, 2.0


def command_m(ahead_m, ground_m):
    """Return the commanded height for ground at places ahead."""
    way_m = np.maximum(ahead_m - SPEED_MPS * LAG_S, 0.0)
    return np.max(ground_m - 0.8 * CLIMB_MPS / SPEED_MPS * way_m) + HEIGHT_M


@dataclass
class ByRadar:
    """The median height of the radar's points in each two metres of the way ahead; older than four seconds they go."""

    radar: Radar
    places_m: list = field(default_factory=list)

    def __call__(self, time_s, place_m, climb_mps):
        frame = self.radar.step(time_s, place_m, (0.0, 0.0, np.pi / 2), (SPEED_MPS, 0.0, climb_mps))
        self.places_m = [*self.places_m, frame.points.position_m][-80:]
        x, y, z = np.concatenate(self.places_m).T
        bins_m = place_m[0] + np.arange(0.0, AHEAD_M, BIN_M)
        on_the_way = [z[(np.abs(y) <= ASIDE_M) & (np.abs(x - at_m) <= BIN_M / 2)] for at_m in bins_m]
        seen = np.array([len(heights) > 0 for heights in on_the_way])
        if not seen.any():
            return place_m[2]
        ground_m = np.array([np.median(heights) for heights in on_the_way if len(heights)])
        ahead_m = (bins_m - place_m[0])[seen]
        # It does not descend to ground that it has not seen yet.
        least_m = -np.inf if ahead_m[0] <= SPEED_MPS * LAG_S else place_m[2]
        return max(command_m(ahead_m, ground_m), least_m)


def by_altimeter(ground_m):
    """Return the command of a perfect altimeter that looks down."""
    return lambda _, place_m, __: HEIGHT_M + ground_m(np.array([place_m[:2]]))[0]


def by_map(ground_m):
    """Return the command by ground that is known beforehand."""

    def command(_, place_m, __):
        ahead_m = np.arange(0.0, AHEAD_M, BIN_M)
        way = np.column_stack([place_m[0] + ahead_m, np.full(len(ahead_m), place_m[1])])
        return command_m(ahead_m, ground_m(way))

    return command


def fly(command, ground_m, length_m=LENGTH_M):
    """Return time, place and climb of each step of a flight by a command."""
    start_m = RADAR["platform"]["start_m"]
    place_m = np.array([*start_m, ground_m(np.array([start_m]))[0] + HEIGHT_M])
    climb_mps, flown = 0.0, []
    for step in range(round(length_m / SPEED_MPS / STEP_S)):
        wanted_m = command(step * STEP_S, place_m, climb_mps)
        climb_mps = float(np.clip((wanted_m - place_m[2]) / LAG_S, -CLIMB_MPS, CLIMB_MPS))
        flown.append([step * STEP_S, *place_m, climb_mps])
        place_m = place_m + STEP_S * np.array([SPEED_MPS, 0.0, climb_mps])
    return np.array(flown)


def clearance_m(prepared, flown):
    """Return the heights of a flight over what is straight below: ground, roofs or the tops of plants."""
    place_m, scene = flown[:, 1:4], prepared.world.scene
    top_m = prepared.world.caster.from_above(place_m[:, :2], 1e4)
    if scene.vegetation is not None:
        top_m = np.fmax(top_m, scene.vegetation.tops_m(place_m[:, :2]))
    return place_m[:, 2] - top_m


def steered(scenario):
    """Return the prepared world and the flights by radar, altimeter and map, by name."""
    prepared = prepare(scenario)
    ground_m = lambda place_m: prepared.world.caster.from_above(place_m, 1e4)  # noqa: E731
    radar = Radar(prepared)
    radar.warm_up()
    by = {
        "radar, looking ahead": ByRadar(radar),
        "altimeter, looking down": by_altimeter(ground_m),
        "the map itself": by_map(ground_m),
    }
    return prepared, {name: fly(command, ground_m) for name, command in by.items()}


def told(name, clearance):
    """Return a line of what a flight kept."""
    rms_m = np.sqrt(np.mean((clearance - HEIGHT_M) ** 2))
    return f"{name:26s} least {clearance.min():5.1f} m, RMS {rms_m:4.1f} m, under 10 m {np.mean(clearance < 10):4.0%}"


# %%
# Over hills, and over a house that stands in the way.
WORLDS = {
    "hills": load_scenario("hills", RADAR),
    "house": load_scenario("hills", RADAR | {
        "terrain.height_m": 2.0, "buildings": [{"position_m": [0.0, 0.0], "size_m": [20.0, 14.0, 9.0]}],
        "materials.building": {"model": "constant_gamma", "terrain_class": "city"},
    }),
}  # fmt: skip
figure = Figure(figsize=(8, 6), layout="constrained")
for axes, (world, scenario) in zip(figure.subplots(2, sharex=True), WORLDS.items(), strict=True):
    prepared, flights = steered(scenario)
    print(world)
    for name, flown in flights.items():
        clearance = clearance_m(prepared, flown)
        print("  " + told(name, clearance))
        axes.plot(flown[:, 1], flown[:, 3], label=name)
    axes.fill_between(flown[:, 1], flown[:, 3] - clearance, flown[:, 3].min() - 25, color="0.8")
    axes.set_ylabel("height, m")
axes.legend()
axes.set_xlabel("east, m")
figure.savefig("terrain_following.png", dpi=110)
