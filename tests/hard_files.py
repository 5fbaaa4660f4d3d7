"""Commands that read a file of each kind, whole or damaged: logs, clouds, meshes, polygons, recordings, references."""

import json
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import laspy
import numpy as np
import trimesh
from hypothesis import strategies as st
from pyproj import CRS

import flight_logs
from elevation_files import from_origin, write_heights
from hard_inputs import HardInput
from mutants import mutated
from surveys import SMALL
from vector_files import rectangle, write_geojson

CONFIG = """channelCfg 3 1 0
adcCfg 2 1
profileCfg 0 77 7 6 60 0 0 60 1 64 5000 0 0 30
chirpCfg 0 0 0 0 0 0 0 1
frameCfg 0 0 8 3 50 1 0
"""
STUDIO = {
    "rlChanCfg_t": {"rxChannelEn": "0x3", "txChannelEn": "0x1"},
    "rlAdcOutCfg_t": {"fmt": {"b2AdcBits": 2, "b2AdcOutFmt": 1}},
    "rlProfiles": [
        {
            "rlProfileCfg_t": {
                "profileId": 0, "startFreqConst_GHz": 77.0, "idleTimeConst_usec": 7.0, "adcStartTimeConst_usec": 6.0,
                "rampEndTime_usec": 60.0, "freqSlopeConst_MHz_usec": 60.0, "numAdcSamples": 64,
                "digOutSampleRate": 5000.0,
            }
        }
    ],
    "rlChirps": [{"rlChirpCfg_t": {"chirpStartIdx": 0, "chirpEndIdx": 0, "profileId": 0, "txEnable": "0x1"}}],
    "rlFrameCfg_t": {"chirpStartIdx": 0, "chirpEndIdx": 0, "numLoops": 8, "numFrames": 3, "framePeriodicity_msec": 50},
}  # fmt: skip
PROCESSING = "[processing]\nmin_range_m = 0.5\n[processing.cfar]\nguard = 2\ntraining = 4\n"
SWEEP = "[sweep]\ncarrier_hz = 78e9\nbandwidth_hz = 1e9\nsampling_rate_hz = 5e6\npulse_rate_hz = 100.0\n"


@dataclass(frozen=True)
class Subject:
    """A command, the files that it reads by their names, and which of them may be damaged."""

    arguments: list[str]
    files: dict[str, bytes]
    victims: tuple[str, ...]


def _written(name: str, write: Callable[[Path], object]) -> bytes:
    with TemporaryDirectory() as folder:
        write(Path(folder) / name)
        return (Path(folder) / name).read_bytes()


def _cloud(path: Path) -> None:
    header = laspy.LasHeader(point_format=6, version="1.4")
    header.offsets, header.scales = [690_000.0, 5_330_000.0, 0.0], [0.001, 0.001, 0.001]
    header.add_crs(CRS.from_epsg(32632))
    cloud = laspy.LasData(header)
    place = np.random.default_rng(1).uniform(0, 300, size=(2, 4000))
    cloud.x, cloud.y, cloud.z = place[0] + 690_000, place[1] + 5_330_000, 0.1 * place[0]
    cloud.return_number[:] = 1
    cloud.write(path)


def _raster(path: Path) -> None:
    heights = np.random.default_rng(1).normal(50, 3, size=(60, 60)).astype(np.float32)
    corner = from_origin(690_000.0, 5_330_300.0, 5.0, 5.0)
    if path.suffix == ".xyz":
        rows = (f"{690_002.5 + 5 * n} {5_330_297.5 - 5 * m} {heights[m, n]:.2f}" for m, n in np.ndindex(heights.shape))
        path.write_text("\n".join(rows))
    elif path.suffix == ".asc":
        write_heights(path, heights, corner, None, driver="AAIGrid")
    else:
        write_heights(path, heights, corner, compress="deflate")


def _beats() -> np.ndarray:
    time_s = np.arange(64) / 5e6
    rng = np.random.default_rng(2)
    noise = rng.normal(size=(24, 2, 64)) + 1j * rng.normal(size=(24, 2, 64))
    return 20 * noise + 3000 * np.exp(2j * np.pi * 1e6 * time_s)


def _capture() -> bytes:
    beat = _beats().reshape(24, 2, 32, 1, 2)
    return np.round(np.concatenate([beat.real, beat.imag], axis=3)).astype("<i2").tobytes()


def _over(kind: str, name: str) -> bytes:
    terrain = f'kind = "{kind}"\npath = "{name}"\ncrs = "EPSG:32632"'
    return SMALL.replace('kind = "flat"\nsize_m = [300.0, 300.0]', terrain).encode()


@cache
def subjects() -> dict[str, Subject]:
    """Return every kind of file with a command that reads it."""
    found = {}
    for kind, (name, write) in flight_logs.WRITERS.items():
        content = _written(
            name, lambda path, write=write: write(path, flight_logs.flown(flight_logs.regular(10.0, 4.0)))
        )
        found[f"log, {kind}"] = Subject(["log", name], {name: content}, (name,))
    flight = flight_logs.flown(flight_logs.regular(10.0, 4.0))
    for name, write, options in (
        ("sbet.out", flight_logs.write_sbet, []),
        ("helios.trj", flight_logs.write_trj, ["--crs", "EPSG:32632"]),
    ):
        content = _written(name, lambda path, write=write: write(path, flight))
        found[f"log, {name}"] = Subject(["log", name, *options], {name: content}, (name,))
    for name in ("dem.tif", "dem.asc", "dem.xyz"):
        files = {name: _written(name, _raster), "hard.toml": _over("raster", name)}
        found[name] = Subject(["run", "hard.toml", "--no-report"], files, (name,))
    for name in ("cloud.las", "cloud.laz"):
        files = {name: _written(name, _cloud), "hard.toml": _over("points", name)}
        found[name] = Subject(["run", "hard.toml", "--no-report"], files, (name,))
    ball = trimesh.creation.icosphere(subdivisions=1, radius=2.0)
    for name in ("ball.ply", "ball.stl", "ball.obj", "ball.glb"):
        scene = SMALL + f'[[objects]]\npath = "{name}"\nposition_m = [-40.0, 0.0]\nmaterial = "building"\n'
        files = {name: _written(name, ball.export), "hard.toml": scene.encode()}
        found[name] = Subject(["run", "hard.toml", "--no-report"], files, (name,))
    rings = [[rectangle(20 * i, 0, 20 * i + 10, 10)] for i in range(3)]
    outlines = _written("a.geojson", lambda path: write_geojson(path, [(ring, {"height": 4}) for ring in rings]))
    footprints = SMALL + '[[footprints]]\npath = "a.geojson"\nheight = "height"\n'
    found["footprints"] = Subject(["validate", "hard.toml"], {"a.geojson": outlines, "hard.toml": footprints.encode()},
                                  ("a.geojson", "hard.toml"))  # fmt: skip
    studio = json.dumps({"mmWaveDevices": [{"rfConfig": STUDIO}]})
    for config, text in {"profile.cfg": CONFIG, "studio.mmwave.json": studio}.items():
        toml = f'[recording]\nsamples = "adc.bin"\nconfig = "{config}"\n{PROCESSING}'
        files = {"adc.bin": _capture(), config: text.encode(), "hard.toml": toml.encode()}
        described = ["process", "adc.bin", "--describe", config]
        found[f"description by {config}"] = Subject(described, files, (config, "adc.bin"))
        found[f"capture, {config}"] = Subject(["process", "hard.toml"], files, (config, config, "adc.bin", "hard.toml"))
    for name, save in {"beats.npy": np.save, "beats.npz": np.savez, "packed.npz": np.savez_compressed}.items():
        content = _written(name, lambda path, save=save: save(path, _beats()[:, 0]))
        toml = f'[recording]\nsamples = "{name}"\nvariable = "arr_0"\n{SWEEP}{PROCESSING}'
        files = {name: content, "hard.toml": toml.encode()}
        found[name] = Subject(["process", "hard.toml"], files, (name, name, "hard.toml"))
    rows = "".join(f"{0.1 * n},{40 + np.sin(n):.3f}\n" for n in range(60))
    readings = {"alt.csv": f"time_s,range_m\n{rows}".encode(), "hard.toml": b'[readings]\nfile = "alt.csv"\n'}
    found["readings"] = Subject(["process", "hard.toml"], readings, ("alt.csv", "hard.toml"))
    levels = "cover,incidence_deg,polarization,sigma0_db,looks\n" + "".join(
        f"ground,{angle},VV,{-20 - angle / 10},50\n" for angle in range(20, 70, 5)
    )
    fit = ["fit-materials", "small.toml", "--levels", "levels.csv"]
    found["levels"] = Subject(fit, {"levels.csv": levels.encode()}, ("levels.csv",))
    found["scenario"] = Subject(["validate", "hard.toml"], {"hard.toml": SMALL.encode()}, ("hard.toml",))
    places = [(x, y) for x in range(-60, 60, 2) for y in range(-70, 70, 2)]
    points = "x,y,z,sigma\n" + "".join(f"{x},{y},0.1,0.05\n" for x, y in places)
    longer = (b"length_m = 5.0", b"length_m = 15.0"), (b"[tracing]", b"[dem]\nspacing_m = 3.0\n[tracing]")
    over = {"small.toml": SMALL.encode(), "raster.toml": _over("raster", "ground.tif")}
    for before, after in longer:
        over = {name: content.replace(before, after) for name, content in over.items()}
    command = ["run", "hard.toml", "--no-report", "--reference"]
    files = {"points.csv": points.encode(), "hard.toml": over["small.toml"]}
    found["reference, points"] = Subject([*command, "points.csv"], files, ("points.csv",))
    flown = {"ground.tif": _written("ground.tif", _raster), "hard.toml": over["raster.toml"]}
    for name, write in {"known.tif": _raster, "known.las": _cloud}.items():
        found[f"reference, {name}"] = Subject([*command, name], flown | {name: _written(name, write)}, (name,))
    return found


@st.composite
def damaged_files(draw: st.DrawFn) -> HardInput:
    """A command that reads a file, one of whose files is damaged."""
    subject = subjects()[draw(st.sampled_from(sorted(subjects())))]
    victim, seed = draw(st.sampled_from(subject.victims)), draw(st.integers(0, 2**32 - 1))
    files = dict(subject.files)
    files[victim] = mutated(files[victim], np.random.default_rng(seed))
    return HardInput(subject.arguments, files)
