"""What a command loads: nothing that draws, and nothing that talks to a network."""

import subprocess
import sys
from pathlib import Path

# matplotlib takes a tenth of a warm run, requests and their kin a hundredth.
SLOW = ("matplotlib", "requests", "urllib3", "pythreejs", "ipywidgets", "IPython", "pandas", "sklearn", "dask")
LOADED = f"print(sorted({{name.partition('.')[0] for name in sys.modules}} & {set(SLOW)}))"


def loaded_by(code: str) -> str:
    """Return which of the slow modules a fresh process has loaded after some code."""
    script = f"import sys\n{code}\n{LOADED}"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout.splitlines()[-1]


def test_surveys_and_their_files_load_nothing_that_draws_and_a_figure_does(tmp_path: Path) -> None:
    """One process flies all: the first that loads something is told by name; in the end figures are noticed."""
    small = {"platform.length_m": 2.0, "tracing.paths_per_pulse": 32}
    scenes = {"hills": {}, "jacksboro": {}, "two_fields": {}, "buildings": {"dem.method": "stepped"}, "rain": {}}
    flights = (
        "from sionna_radar import load_scenario, run\n"
        "from sionna_radar.report.survey.products import write_survey\n"
        "from pathlib import Path\n"
        "from sionna_radar.survey.sensors import sweeps\n"
        "sweeps.VOLUME_PULSES, sweeps.MOTION_PULSES = 64, 128\n"
        f"for name, keys in {scenes!r}.items():\n"
        f"    write_survey(run(load_scenario(name, {small!r} | keys)), Path({str(tmp_path)!r}) / name)\n"
        f"    assert not any(slow in sys.modules for slow in {SLOW!r}), name\n"
        "from sionna_radar.report.survey import figures"
    )
    assert loaded_by(flights) == "['matplotlib']"
    assert all((tmp_path / name / "summary.json").is_file() for name in scenes)


def test_scenarios_are_read_and_keys_completed_without_scipy_and_names_without_numpy() -> None:
    """Each press of the tabulator key starts a process."""
    code = (
        "from sionna_radar.cli.session import complete_key, complete_scenario\n"
        "assert complete_scenario('hi') == ['hills']\n"
        "assert 'numpy' not in sys.modules\n"
        "assert 'radar.antenna.beamwidth_deg=' in complete_key('radar.ant')\n"
        "assert 'scipy' not in sys.modules\n"
        "from sionna_radar import load_scenario\n"
        "load_scenario('hills')\n"
        "assert 'scipy' not in sys.modules"
    )
    assert loaded_by(code) == "[]"


def test_sionna_rt_draws_though_matplotlib_was_not_there_when_it_was_loaded() -> None:
    drawn = (
        "from sionna_radar.raytracer.backend import load_sionna\n"
        "rt = load_sionna()\n"
        "assert 'matplotlib' not in sys.modules\n"
        "import matplotlib\n"
        "matplotlib.use('agg')\n"
        "from sionna.rt import antenna_pattern\n"
        "pattern = rt.antenna_pattern.antenna_pattern_registry.get('tr38901')(polarization='V')\n"
        "assert len(pattern.show()) == 3\n"
        "array = rt.PlanarArray(num_rows=2, num_cols=2, pattern='iso', polarization='V')\n"
        "assert array.show() is not None"
    )
    assert "matplotlib" in loaded_by(drawn)


def test_loops_of_sionna_rt_are_rewritten_when_they_first_run() -> None:
    used = (
        "from sionna_radar.raytracer.backend import load_sionna\n"
        "rt = load_sionna()\n"
        "from drjit import ast\n"
        "assert ast._syntax_counter == 0\n"
        "scene = rt.load_scene(rt.scene.simple_reflector, merge_shapes=False)\n"
        "scene.tx_array = scene.rx_array = rt.PlanarArray(num_rows=1, num_cols=1, pattern='iso', polarization='V')\n"
        "scene.add(rt.Transmitter('tx', [0.0, 0.0, 2.0]))\n"
        "scene.add(rt.Receiver('rx', [1.0, 0.0, 2.0]))\n"
        "paths = rt.PathSolver()(scene, max_depth=1)\n"
        "assert isinstance(paths, rt.Paths) and ast._syntax_counter > 0\n"
        "levels = rt.RadioMapSolver()(scene, max_depth=1, cell_size=(1.0, 1.0), samples_per_tx=1000)\n"
        "assert isinstance(levels, rt.PlanarRadioMap)"
    )
    assert loaded_by(used) == "[]"


def test_sionna_rt_is_loaded_where_matplotlib_was_before() -> None:
    code = (
        "import matplotlib.pyplot as plt\n"
        "from sionna_radar.raytracer.backend import load_sionna\n"
        "load_sionna()\n"
        "assert sys.modules['matplotlib.pyplot'] is plt"
    )
    assert "matplotlib" in loaded_by(code)


def test_rasterio_is_loaded_for_files_and_numba_by_the_first_compiled_function_that_is_called() -> None:
    code = (
        "from sionna_radar import load_scenario, prepare\n"
        "prepare(load_scenario('two_fields'))\n"
        "assert 'numba' not in sys.modules and 'rasterio' not in sys.modules\n"
        "from sionna_radar.foundation.compiled import turned\n"
        "assert turned(0.25) == (0.0, 1.0)\n"
        "assert 'numba' in sys.modules"
    )
    assert loaded_by(code) == "[]"
