"""What the benchmark measures: engines and imaging against their least work, growth, reuse, start and backends."""

import json
import math
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from time import perf_counter
from typing import Any, no_type_check

import numpy as np
from jaxtyping import Float

from sionna_radar.execution.execution import Execution
from sionna_radar.flight.pulses import Pulses
from sionna_radar.foundation.compiled import compiled, turned
from sionna_radar.foundation.memory import peak_memory_mb
from sionna_radar.foundation.threads import over_rows
from sionna_radar.mapping.points import locate
from sionna_radar.raytracer.backend import BACKEND_VARIABLE, gpu_usable
from sionna_radar.scenario import Scenario, load_scenario
from sionna_radar.studies.images.aperture import ground_pixels, whole_beam
from sionna_radar.studies.images.sar import ZERO_PADDING, BackProjection
from sionna_radar.survey.chain import run
from sionna_radar.survey.preparation import Prepared, prepare
from sionna_radar.survey.sensors.mimo import Mimo
from sionna_radar.tracing.paths import Paths


@dataclass(frozen=True, kw_only=True)
class Ratio:
    """A measured ratio and the bound it must keep; None for one that is only told."""

    name: str
    value: float
    bound: float | None
    at_most: bool

    @property
    def kept(self) -> bool:
        """Whether the bound is kept."""
        return self.bound is None or (self.value <= self.bound) == self.at_most

    def __str__(self) -> str:
        if self.bound is None:
            return f"{self.name:62}{self.value:12,.2f}"
        word = "at most" if self.at_most else "at least"
        verdict = "ok" if self.kept else "MISSED"
        return f"{self.name:62}{self.value:12,.2f}   {word} {self.bound:,.2f}   {verdict}"


Action = Callable[[], object]
# By which a process of its own finds this module.
HERE = {"PYTHONPATH": str(Path(__file__).parent)}


def seconds_of(action: Action) -> float:
    """Return how long an action takes."""
    start = perf_counter()
    action()
    return perf_counter() - start


def side_by_side(actions: Sequence[Action], repeats: int) -> Float[np.ndarray, "repeat action"]:
    """Return the seconds of each action in each repetition, after one that does not count."""
    for action in actions:
        action()
    return np.array([[seconds_of(action) for action in actions] for _ in range(repeats)])


def bare_casting(prepared: Prepared, paths: Paths, pulses: Pulses) -> Action:
    """Return a function that intersects the rays of paths with the scene, by Mitsuba, and does nothing else."""
    row = paths.pulse - pulses.index[0]
    origin = pulses.true.position_m[row]
    away = paths.hit_m - origin
    rays = prepared.world.caster.prepare(origin, away / np.linalg.norm(away, axis=1, keepdims=True))
    return lambda: prepared.world.caster.intersect(rays)


TERRAINS = ("hills", "san_francisco")
SPECKLES = ("persistent", "per_pulse")
REPEATS = 3


def backend_ratios() -> int:
    """Return how many ratios there are on this machine."""
    return len(TERRAINS) * len(SPECKLES) * (2 if gpu_usable() else 1)


def measure_backends(pulses: int) -> Iterator[Ratio]:
    """Yield the chirps a second of the CPU, and of a usable GPU over those, each in a process of its own."""
    for terrain in TERRAINS:
        for speckle in SPECKLES:
            name = f"{terrain}, {speckle.replace('_', ' ')} speckle"
            host = _in_process("llvm", terrain, speckle, pulses)
            yield Ratio(name=f"chirps a second, {name}, CPU", value=host, bound=None, at_most=False)
            if gpu_usable():
                ratio = _in_process("cuda", terrain, speckle, pulses) / host
                yield Ratio(name=f"chirps a second, {name}, GPU / CPU", value=ratio, bound=None, at_most=False)


def chirps_a_second(terrain: str, speckle: str, count: int) -> float:
    """Return how many chirps a second this process traces, receives, transforms and searches for echoes."""
    prepared = prepare(load_scenario(terrain, {"tracing.speckle": speckle}))
    sensor, pulses = prepared.build_sensor(), prepared.flight.pulses(np.arange(min(count, len(prepared))))

    def seconds() -> float:
        start = perf_counter()
        sensor.observe(pulses)
        return perf_counter() - start

    seconds()
    return len(pulses) / min(seconds() for _ in range(REPEATS))


def _in_process(backend: str, terrain: str, speckle: str, count: int) -> float:
    code = f"from {__name__} import chirps_a_second\nprint(chirps_a_second({terrain!r}, {speckle!r}, {count}))\n"
    settings = {**os.environ, **HERE, BACKEND_VARIABLE: backend}
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, env=settings)
    return float(done.stdout)


ENGINE_RATIOS = 3
FLOOR_BOUND = 2.0
ENGINE_REPEATS = 7
# Pixels beside the track, m, and steps between them.
ALONG_M, ACROSS_M, STEP_M = (-3.0, 3.0), (24.0, 32.0), 0.04


# Virtual channels of a module over those of one, with the same scatterers and as many chirps of each transmitter.
CHANNEL_BOUNDS = {(3, 4): 4.0, (12, 16): 40.0}


def measure_channels(frames: int) -> Iterator[Ratio]:
    """Yield what the signals of frames take, traced paths and noise included, over those of one channel."""
    pulses = np.arange(frames)
    times = {}
    for transmitters, receivers in ((1, 1), *CHANNEL_BOUNDS):
        array = {
            "transmitters_wavelengths": [
                [(n - (transmitters - 1) / 2) * receivers / 2, 0.0] for n in range(transmitters)
            ],
            "receivers_wavelengths": [[(n - (receivers - 1) / 2) / 2, 0.0] for n in range(receivers)],
            "chirps": 32,
        }
        prepared = prepare(
            load_scenario(
                "hills",
                {
                    "sensor": "mimo",
                    "radar": {"preset": "ti_awr1843_array", "array": array},
                    "tracing.paths_per_pulse": 8000,
                },
            )
        )
        sensor, flown = prepared.build_sensor(), [prepared.flight.pulses(pulses[n : n + 1]) for n in range(frames)]
        assert isinstance(sensor, Mimo)
        receive = partial(_received, sensor, flown)
        receive()
        times[transmitters, receivers] = min(seconds_of(receive) for _ in range(3))
    for (transmitters, receivers), bound in CHANNEL_BOUNDS.items():
        ratio = times[transmitters, receivers] / times[1, 1]
        name = f"signals of {transmitters * receivers} channels / of one"
        yield Ratio(name=name, value=ratio, bound=bound, at_most=True)


def _received(sensor: Mimo, frames: Sequence[Pulses]) -> None:
    for frame in frames:
        sensor.frame(frame)


def measure_engines(pulses: int) -> Iterator[Ratio]:
    """Yield what tracing and focusing take over their floors, ENGINE_RATIOS of them."""
    wide, facets = (
        prepare(load_scenario("hills", settings))
        for settings in ({"radar.antenna.beamwidth_deg": 8.0}, {"tracing.engine": "gamma"})
    )
    yield _ratio("persistent scatterers, 8 deg / bare rays to them", *_tracing(wide, pulses))
    yield _ratio("gamma engine / its facets touched once, in NumPy", *_facets(facets, pulses // 4))
    yield _ratio("SAR focusing / its samples summed, nearest ones", *_focusing(pulses))


def _ratio(name: str, action: Action, floor: Action) -> Ratio:
    times = side_by_side([action, floor], ENGINE_REPEATS).min(axis=0)
    return Ratio(name=name, value=float(times[0] / times[1]), bound=FLOOR_BOUND, at_most=True)


def _tracing(prepared: Prepared, count: int) -> tuple[Action, Action]:
    tracer, pulses = prepared.sensor_inputs().tracer(), prepared.flight.pulses(np.arange(min(count, len(prepared))))
    return partial(tracer.trace, pulses), bare_casting(prepared, tracer.trace(pulses), pulses)


def _facets(prepared: Prepared, count: int) -> tuple[Action, Action]:
    """Return the tracing of facets, and their distances, gains, phases and ray tests by whole arrays."""
    tracer, pulses = prepared.sensor_inputs().tracer(), prepared.flight.pulses(np.arange(min(count, len(prepared))))
    paths = tracer.trace(pulses)
    row = paths.pulse - pulses.index[0]
    chirp, antenna, caster = prepared.receiver.chirp, prepared.instrument.antenna, prepared.world.caster

    def touch() -> None:
        origin, point = pulses.true.position_m[row], paths.hit_m.astype(np.float64)
        away = point - origin
        range_m = np.linalg.norm(away, axis=1)
        ahead = np.einsum("ni,nij->nj", away / range_m[:, None], pulses.true.R_world_antenna[row])
        amplitude = antenna.gain(ahead) * np.sqrt(np.cos(paths.incidence_rad)) / range_m**2
        amplitude * np.exp(4j * np.pi * np.mod(range_m / chirp.wavelength_m, 1.0))
        caster.visible(origin, point)

    return partial(tracer.trace, pulses), touch


def _focusing(count: int) -> tuple[Action, Action]:
    """Return the focusing of pixels, and the sum of the nearest samples of the same spectra."""
    prepared = prepare(load_scenario("slar"))
    chirp, aperture = prepared.receiver.chirp, whole_beam(prepared.instrument.antenna)
    middle = (len(prepared) - min(count, len(prepared))) // 2
    pulses = prepared.flight.pulses(np.arange(middle, len(prepared) - middle))
    pose = pulses.measured
    along_m, across_m = (np.arange(low, high, STEP_M) for low, high in (ALONG_M, ACROSS_M))
    pixels = ground_pixels(pose, "right", 0.0, along_m + _length_m(pose.position_m) / 2, across_m)
    beats = prepared.receiver.beat(prepared.sensor_inputs().tracer().trace(pulses), pulses)
    projection = BackProjection(chirp, pixels, aperture)
    spectra = projection.spectra(beats)
    place, image = pixels.position_m.reshape(-1, 3), np.empty(pixels.position_m.size // 3, dtype=np.complex128)
    scales = (ZERO_PADDING / chirp.range_resolution_m, 2 / chirp.wavelength_m)

    def add() -> None:
        over_rows(
            lambda low, high: nearest_samples(
                low, high, place, pose.position_m, spectra, *scales, aperture.reach, pixels.along, image
            ),
            len(place),
        )

    return partial(projection.add, beats, pose), add


def _length_m(position_m: np.ndarray) -> float:
    return float(np.linalg.norm(position_m[-1] - position_m[0]))


FACETS = (10_000, 100_000, 1_000_000, 10_000_000)
PULSES = (1_000, 200_000)
TERRAIN_M = 320.0
# Pulses by which all that a survey keeps for its whole length has been allocated.
SETTLED_SHARE = 0.1


def measure_growth() -> Iterator[Ratio]:
    """Yield the ratios as they are measured; minutes in all."""
    yield from _growth_facets()
    yield from _pulses()


def _growth_facets() -> Iterator[Ratio]:
    """Yield time per pulse and memory over terrains of more and more facets, over the same ground."""
    least = _growth_in_process("over_facets", FACETS[0])
    for count in FACETS[1:]:
        found = _growth_in_process("over_facets", count)
        name = f"{found['facets']:,} / {least['facets']:,} facets, trace to echoes"
        yield Ratio(name=f"time a pulse, {name}", value=found["pulse_s"] / least["pulse_s"], bound=2.5, at_most=True)
    each = 1e6 * (found["peak_mb"] - least["peak_mb"]) / (found["facets"] - least["facets"])
    yield Ratio(name="memory a facet, bytes", value=each, bound=None, at_most=True)


def _pulses() -> Iterator[Ratio]:
    """Yield how time and memory of a survey grow with its pulses, and what a long one leaves behind."""
    few, many = (_growth_in_process("over_pulses", count) for count in PULSES)
    name = f"{many['pulses']:,} / {few['pulses']:,} pulses"
    each = [found["flown_s"] / found["pulses"] for found in (few, many)]
    yield Ratio(name=f"time a pulse, {name}", value=each[1] / each[0], bound=1.1, at_most=True)
    yield Ratio(name=f"peak memory, {name}", value=many["peak_mb"] / few["peak_mb"], bound=1.1, at_most=True)
    growth, at = many["settled_mb"][1] / many["settled_mb"][0], f"{SETTLED_SHARE:.0%} of {many['pulses']:,} pulses"
    yield Ratio(name=f"memory at the end / at {at}", value=growth, bound=1.1, at_most=True)
    left = float(many["handles"] + many["temporary_files"])
    yield Ratio(name="open handles and temporary files more at the end", value=left, bound=0.0, at_most=True)


def over_facets(count: int) -> dict[str, Any]:
    """Return what some pulses take over `hills` of so many facets: seconds each, and the memory of this process."""
    spacing_m = TERRAIN_M / np.sqrt(count / 2)
    prepared = prepare(load_scenario("hills", {"terrain.spacing_m": float(f"{spacing_m:.6g}")}))
    pulses = prepared.flight.pulses(np.arange(500))
    tracer = prepared.sensor_inputs().tracer()

    def chain() -> float:
        start = perf_counter()
        beat = prepared.receiver.beat(tracer.trace(pulses), pulses)
        echoes = prepared.instrument.detector.detect(beat, pulses.index, pulses.measured)
        locate(echoes, pulses.index, pulses.measured)
        return perf_counter() - start

    seconds = min(chain() for _ in range(6))
    facets = sum(len(surface.faces) for surface in prepared.world.scene.surfaces)
    return {"facets": facets, "pulse_s": seconds / len(pulses), "peak_mb": peak_memory_mb()}


def over_pulses(count: int) -> dict[str, Any]:
    """Return what a survey of so many pulses takes after preparation, and what it leaves open."""
    run(long_survey(PULSES[0]))
    resident: list[tuple[float, float]] = []

    def progress(stage: str, done: int, total: int) -> None:
        if stage == "tracing" and total:
            resident.append((done / total, _resident_mb()))

    handles, files = _handles(), _temporary_files()
    survey = run(long_survey(count), execution=Execution(progress=progress))
    settled = [mb for share, mb in resident if share >= SETTLED_SHARE]
    return {
        "pulses": survey.pulses,
        "flown_s": survey.timing_s["total"] - survey.timing_s["prepare"],
        "peak_mb": peak_memory_mb(),
        "settled_mb": [settled[0], settled[-1]],
        "handles": _handles() - handles,
        "temporary_files": _temporary_files() - files,
    }


def long_survey(pulses: int) -> Scenario:
    """Return a survey of about that many pulses over the same ground: the more pulses, the slower the flight."""
    sector = 100 / 360
    return load_scenario("hills", {"platform.speed_mps": 100.0 * 360 * sector / pulses})


def _resident_mb() -> float:
    with Path("/proc/self/statm").open() as file:
        return int(file.read().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6


def _handles() -> int:
    return sum(1 for _ in Path("/proc/self/fd").iterdir())


def _temporary_files() -> int:
    return sum(1 for _ in Path(tempfile.gettempdir()).iterdir())


def _growth_in_process(function: str, count: int) -> dict[str, Any]:
    says = "import json\nprint(json.dumps"
    heaps = "from sionna_radar.foundation.progress import tune_heaps\ntune_heaps()"
    code = f"{heaps}\nfrom {__name__} import {function}\n{says}({function}({count})))\n"
    # A place of its own for temporary files, so that only what it leaves there is counted.
    with tempfile.TemporaryDirectory() as own:
        done = subprocess.run(
            [sys.executable, "-c", code],
            capture_output=True,
            text=True,
            check=True,
            env={**os.environ, **HERE, "TMPDIR": own},
        )
    found: dict[str, Any] = json.loads(done.stdout)
    return found


# What every survey of a study has to do itself.
OWN_STAGES = ("trace", "synthesise", "detect", "map")


def measure_reuse(cells: int, length_m: float) -> Iterator[Ratio]:
    """Yield how long `hills` takes to prepare, and what a study over it costs beside its surveys' own stages."""
    prepare(load_scenario("hills")).build_sensor()
    # Another terrain each time, so that nothing of the last one serves again.
    anew = min(_preparation_s({"terrain.seed": 2 + trial}) for trial in range(3))
    again = min(_preparation_s({"terrain.seed": 4, "seed": 2 + trial}) for trial in range(3))
    yield Ratio(name="seconds to prepare hills", value=anew, bound=0.35, at_most=True)
    yield Ratio(name="seconds to prepare hills over the same terrain", value=again, bound=None, at_most=True)
    yield study_over_stages(cells, length_m)


def study_over_stages(cells: int, length_m: float) -> Ratio:
    """Return the time of a study over one terrain, over that of all its traces, syntheses, detections and maps."""
    spent = taken = 0.0
    for cell in range(cells + 1):
        changes = {
            "seed": 1 + cell,
            "radar.snr_db": 20.0 + cell % 5,
            "processing.window": ("hann", "taylor")[cell % 2],
            "platform.length_m": length_m,
        }
        start = perf_counter()
        survey = run(load_scenario("hills", changes))
        if cell:  # the first one builds the scene, which a study of many has long forgotten
            taken += perf_counter() - start
            spent += sum(survey.timing_s[stage] for stage in OWN_STAGES)
    name = f"study of {cells} surveys over one terrain / its traces to maps"
    return Ratio(name=name, value=taken / spent, bound=1.2, at_most=True)


def _preparation_s(changes: dict[str, object]) -> float:
    start = perf_counter()
    prepare(load_scenario("hills", changes)).build_sensor()
    return perf_counter() - start


def measure_start() -> Iterator[Ratio]:
    """Yield the seconds of imports, of `--help` and of a first survey from the shell, all beside Python's own."""
    python_s = min(_seconds(["-c", "pass"])[1] for _ in range(REPEATS))
    starts = [
        _start_ratio(f"`{name}`", [_seconds(arguments)[1] for _ in range(REPEATS)], python_s, bound_s)
        for name, arguments, bound_s in (
            ("import sionna_radar", ["-c", "import sionna_radar"], 0.15),
            ("--help", ["-m", "sionna_radar", "--help"], 0.15),
            ("import mitsuba", ["-c", "import mitsuba"], None),
        )
    ]
    yield from starts
    mitsuba_s = starts[-1].value
    with tempfile.TemporaryDirectory() as folder:
        flights = [
            _seconds(["-m", "sionna_radar", "run", "hills", "-o", str(Path(folder, str(k)))])
            for k in range(2 * REPEATS)
        ]
    first, last = zip(*flights, strict=True)
    result = _start_ratio("`run hills` until the result is printed", first, python_s, 3.0)
    yield result
    name = "`run hills` until the result is printed / `import mitsuba`"
    yield Ratio(name=name, value=result.value / mitsuba_s, bound=None, at_most=True)
    yield _start_ratio("`run hills` until all is written", last, python_s, None)
    for flight in ("run hills", "demo", "run san_francisco"):
        with tempfile.TemporaryDirectory() as folder:
            command, cache = ["-m", "sionna_radar", *flight.split(), "-o"], Path(folder, "cache")
            empty, filled = (_seconds([*command, str(Path(folder, str(k)))], cache)[1] for k in range(2))
        yield Ratio(name=f"seconds of `{flight}`", value=filled, bound=None, at_most=True)
        name = f"seconds that an empty cache of compiled code adds to `{flight}`"
        yield Ratio(name=name, value=empty - filled, bound=None, at_most=True)


def _start_ratio(name: str, seconds: Sequence[float], python_s: float, bound_s: float | None) -> Ratio:
    """Return the least time of some processes but the first, which fills caches, less that of one that does nothing."""
    return Ratio(name=f"seconds of {name}", value=min(seconds[1:]) - python_s, bound=bound_s, at_most=True)


def _seconds(arguments: list[str], cache: Path | None = None) -> tuple[float, float]:
    """Return the seconds until a process has said something, or has ended without, and until it has ended.

    cache: folder of its compiled code; the usual one if None.
    """
    # Users' byte code is kept: without it half of the time goes into compiling modules.
    kept = {key: value for key, value in os.environ.items() if key != "PYTHONDONTWRITEBYTECODE"}
    kept |= {} if cache is None else {"NUMBA_CACHE_DIR": str(cache)}
    command, start = [sys.executable, *arguments], perf_counter()
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, env=kept) as process:
        assert process.stdout is not None
        process.stdout.readline()
        said_s = perf_counter() - start
        process.stdout.read()
    if process.returncode:
        raise subprocess.CalledProcessError(process.returncode, command)
    return said_s, perf_counter() - start


@compiled
@no_type_check
def nearest_samples(low, high, pixel, apex, spectra, bins_per_m, cycles_per_m, reach, ahead, image):
    """Add to each pixel from low to high the nearest sample of all pulses that light it, turned by its phase.

    pixel, apex: positions in metres; spectra: by pulse and bin; ahead: the direction along the track.
    bins_per_m, cycles_per_m: of a spectrum, and of its phase, for each metre of range; reach: greatest direction cosine
        along the track of a pixel that is lit.
    """
    for n in range(low, high):
        real = imaginary = 0.0
        for k in range(len(apex)):
            x, y, z = pixel[n, 0] - apex[k, 0], pixel[n, 1] - apex[k, 1], pixel[n, 2] - apex[k, 2]
            range_m = math.sqrt(x * x + y * y + z * z)
            if abs(x * ahead[0] + y * ahead[1] + z * ahead[2]) > reach * range_m:
                continue
            c, s = turned(cycles_per_m * range_m)
            value = spectra[k, int(range_m * bins_per_m)]
            real += value.real * c - value.imag * s
            imaginary += value.real * s + value.imag * c
        image[n] = complex(real, imaginary)
