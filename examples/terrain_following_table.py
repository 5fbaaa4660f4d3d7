"""The table of `docs/live.md`: terrain following over hills, a town's edge and your own DEMs, in rain, over trees.

python examples/terrain_following_table.py [DEM.tif ...]
"""

import contextlib
import importlib.util
import io
import os
import sys
from pathlib import Path

import numpy as np

LENGTH_M = 400.0
STAND = {
    "polygon_m": [[-100.0, -60.0], [60.0, -60.0], [60.0, 60.0], [-100.0, 60.0]],
    "height_m": 8.0,
    "extinction_db_per_m": 3.0,
    "backscatter_db_per_m": -12.0,
}
CONDITIONS = {
    "clear air": {},
    "8 m of trees, 160 m long": {"vegetation": [STAND]},
    "rain, 10 mm/h": {"weather.rain_rate_mm_per_h": 10.0},
}


def town():
    """Return a town's edge: 24 houses of 5 to 12 m, from the middle of the flight on."""
    random = np.random.default_rng(3)
    low, high = [0.0, -30.0, 8.0, 7.0, 5.0, 0.0], [180.0, 30.0, 18.0, 12.0, 12.0, 180.0]
    rows = random.uniform(low, high, (24, 6)).tolist()
    houses = [{"position_m": row[:2], "size_m": row[2:5], "heading_deg": row[5]} for row in rows]
    return {
        "terrain.height_m": 2.0,
        "buildings": houses,
        "materials.building": {"model": "constant_gamma", "terrain_class": "city"},
    }


def loop():
    """Return the module of the loop, `plot_terrain_following.py`, without its own flights' output."""
    os.environ["SIONNA_RADAR_SMALL"] = "1"
    spec = importlib.util.spec_from_file_location("loop", Path(__file__).with_name("plot_terrain_following.py"))
    module = importlib.util.module_from_spec(spec)
    with contextlib.redirect_stdout(io.StringIO()):
        spec.loader.exec_module(module)
    module.RADAR["platform"] |= {"length_m": LENGTH_M, "start_m": [-LENGTH_M / 2 - 20.0, 0.0]}
    module.fly.__defaults__ = (LENGTH_M,)
    return module


def main():
    module = loop()
    size = {"terrain.size_m": [700.0, 340.0]}
    worlds = {"hills": size, "town's edge": size | town()}
    worlds |= {
        Path(name).stem: {"terrain": {"kind": "raster", "path": str(Path(name).absolute())}} for name in sys.argv[1:]
    }
    for world, keys in worlds.items():
        for condition, more in CONDITIONS.items():
            prepared, flights = module.steered(module.load_scenario("hills", module.RADAR | keys | more))
            for name, flown in flights.items():
                if condition == "clear air" or name.startswith("radar"):
                    print(f"{world}, {condition}: {module.told(name, module.clearance_m(prepared, flown))}", flush=True)


if __name__ == "__main__":
    main()
