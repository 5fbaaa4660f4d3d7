"""Recordings of other programs, described by a TOML file: every layout gives the range that was put in."""

import csv
import json
import re
from pathlib import Path

import numpy as np
import pytest
import xarray
from scipy.constants import speed_of_light
from scipy.stats import norm

from sionna_radar import process
from sionna_radar.foundation.errors import InputFileError, ScenarioError
from sionna_radar.report.files.contents import Figures
from sionna_radar.report.survey.processed import processed_document, recording_page
from sionna_radar.survey.recording_source import identity_of

SLOPE, RATE_HZ, SAMPLES = 60e12, 5e6, 256
LOOPS, FRAMES, TRANSMITTERS, RECEIVERS = 8, 3, 2, 4
PROCESSING = "[processing]\nmin_range_m = 0.5\n[processing.cfar]\nguard = 4\ntraining = 8\n"
CONFIG = f"""
channelCfg 15 3 0
adcCfg 2 1
profileCfg 0 77 7 6 60 0 0 60 1 {SAMPLES} 5000 0 0 30   % GHz, us, MHz/us, ksps
chirpCfg 0 0 0 0 0 0 0 1
chirpCfg 1 1 0 0 0 0 0 2
frameCfg 0 1 {LOOPS} {FRAMES} 50 1 0
"""


def range_of(transmitter: int, receiver: int) -> float:
    return 4.3 + 0.5 * transmitter + 0.1 * receiver


@pytest.fixture(scope="module")
def sent() -> np.ndarray:
    """Beats (frame, loop, transmitter, receiver, sample) of one target, another range in each channel, with noise."""
    rng = np.random.default_rng(1)
    time_s = np.arange(SAMPLES) / RATE_HZ
    shape = (FRAMES, LOOPS, TRANSMITTERS, RECEIVERS, SAMPLES)
    beat = 20 * (rng.normal(size=shape) + 1j * rng.normal(size=shape))
    for k in range(TRANSMITTERS):
        for m in range(RECEIVERS):
            beat[:, :, k, m] += 6000 * np.exp(2j * np.pi * 2 * SLOPE * range_of(k, m) / speed_of_light * time_s)
    return beat


def described(folder: Path, recording: str, rest: str = "") -> Path:
    path = folder / "recording.toml"
    path.write_text(f"[recording]\n{recording}\n{rest}\n{PROCESSING}", encoding="utf-8")
    return path


def measured(path: Path) -> float:
    return float(np.median(process(path).echoes.range_m))


def capture(folder: Path, sent: np.ndarray, lanes: int = 2) -> None:
    """Write the numbers of a raw capture, value by value, as the card does."""
    numbers: list[float] = []
    for chirp in sent.reshape(-1, RECEIVERS, SAMPLES):
        if lanes == 2:
            for receiver in chirp:
                for a, b in receiver.reshape(-1, 2):
                    numbers += [a.real, b.real, a.imag, b.imag]
        else:
            for n in range(SAMPLES):
                numbers += [*chirp[:, n].real, *chirp[:, n].imag]
    np.round(numbers).astype("<i2").tofile(folder / "adc_data.bin")
    (folder / "profile.cfg").write_text(CONFIG)


@pytest.mark.parametrize(("lanes", "transmitter", "receiver"), [(2, 1, 1), (2, 2, 3), (4, 1, 4)])
def test_a_raw_capture_holds_each_channel_where_the_card_puts_it(tmp_path, sent, lanes, transmitter, receiver):
    capture(tmp_path, sent, lanes)
    choice = f"transmitter = {transmitter}\nreceiver = {receiver}\nlanes = {lanes}"
    path = described(tmp_path, f'samples = "adc_data.bin"\nconfig = "profile.cfg"\n{choice}')
    found = process(path)
    assert abs(np.median(found.echoes.range_m) - range_of(transmitter - 1, receiver - 1)) < 0.005
    (sweep,) = found.sweeps
    assert sweep.carrier_hz == pytest.approx(77e9 + SLOPE * (6e-6 + SAMPLES / RATE_HZ / 2))
    assert sweep.bandwidth_hz == pytest.approx(SLOPE * SAMPLES / RATE_HZ)
    # Two chirps of 67 us in a loop, frames every 50 ms.
    np.testing.assert_allclose(found.time_s[[0, 1, LOOPS]] - (transmitter - 1) * 67e-6, [0, 134e-6, 0.05], atol=1e-12)


@pytest.mark.parametrize("lanes", [2, 4])
def test_a_capture_of_real_samples_is_read_receiver_by_receiver_or_sample_by_sample(tmp_path, sent, lanes):
    beat = sent.real.reshape(-1, RECEIVERS, SAMPLES)
    numbers = beat if lanes == 2 else beat.transpose(0, 2, 1)
    np.round(numbers).astype("<i2").tofile(tmp_path / "adc_data.bin")
    (tmp_path / "profile.cfg").write_text(CONFIG.replace("adcCfg 2 1", "adcCfg 2 0"))
    choice = f'samples = "adc_data.bin"\nconfig = "profile.cfg"\nreceiver = 3\nlanes = {lanes}'
    found = process(described(tmp_path, choice))
    assert found.sweeps[0].sampling == "real"
    assert abs(np.median(found.echoes.range_m) - range_of(0, 2)) < 0.01


@pytest.mark.parametrize("vary", [(0.0, 0.0, 0.0, 0.0), (-4e6, 50.0, 2.0, 1.0)])
def test_both_kinds_of_configuration_say_the_same(tmp_path, sent, vary):
    """Also with variations of the profile: Hz in the one, MHz in the other; kHz/us, us, us."""
    capture(tmp_path, sent)
    config = CONFIG.replace(" 0 0 0 0 1\n", f" {' '.join(map(str, vary))} 1\n")
    config = config.replace(" 0 0 0 0 2\n", f" {' '.join(map(str, vary))} 2\n")
    (tmp_path / "profile.cfg").write_text(config)
    profile = {
        "profileId": 0, "startFreqConst_GHz": 77.0, "idleTimeConst_usec": 7.0, "adcStartTimeConst_usec": 6.0,
        "rampEndTime_usec": 60.0, "freqSlopeConst_MHz_usec": 60.0, "numAdcSamples": SAMPLES, "digOutSampleRate": 5000.0,
    }  # fmt: skip
    names = ("startFreqVar_MHz", "freqSlopeVar_KHz_usec", "idleTimeVar_usec", "adcStartTimeVar_usec")
    varied = dict(zip(names, (1e-6 * vary[0], *vary[1:]), strict=True)) if any(vary) else {}
    chirps = [
        {"chirpStartIdx": k, "chirpEndIdx": k, "profileId": 0, "txEnable": hex(1 << k), **varied} for k in range(2)
    ]
    radio = {
        "rlChanCfg_t": {"rxChannelEn": "0xF", "txChannelEn": "0x3"},
        "rlAdcOutCfg_t": {"fmt": {"b2AdcBits": 2, "b2AdcOutFmt": 1}},
        "rlProfiles": [{"rlProfileCfg_t": profile}],
        "rlChirps": [{"rlChirpCfg_t": chirp} for chirp in chirps],
        "rlFrameCfg_t": {
            "chirpStartIdx": 0,
            "chirpEndIdx": 1,
            "numLoops": LOOPS,
            "numFrames": FRAMES,
            "framePeriodicity_msec": 50,
        },
    }
    (tmp_path / "studio.mmwave.json").write_text(json.dumps({"mmWaveDevices": [{"rfConfig": radio}]}))
    found = [
        process(described(tmp_path, f'samples = "adc_data.bin"\nconfig = "{name}"'))
        for name in ("profile.cfg", "studio.mmwave.json")
    ]
    assert found[0].sweeps == found[1].sweeps
    np.testing.assert_array_equal(found[0].echoes.range_m, found[1].echoes.range_m)
    np.testing.assert_allclose(found[0].time_s, found[1].time_s)
    slope_hz_s = SLOPE + 1e9 * vary[1]
    assert found[0].sweeps[0].bandwidth_hz == pytest.approx(slope_hz_s * SAMPLES / RATE_HZ)
    middle_s = 1e-6 * (6.0 + vary[3]) + SAMPLES / RATE_HZ / 2
    assert found[0].sweeps[0].carrier_hz == pytest.approx(77e9 + vary[0] + slope_hz_s * middle_s)
    np.testing.assert_allclose(np.diff(found[0].time_s)[0], 2e-6 * (67.0 + vary[2]), rtol=1e-9)


SWEEP = (
    f"[sweep]\ncarrier_hz = 78.9e9\nbandwidth_hz = {SLOPE * SAMPLES / RATE_HZ}\nsampling_rate_hz = 5e6\n"
    "pulse_rate_hz = 100.0\n"
)


@pytest.mark.parametrize("axes", ["pulse receiver sample", "sample pulse receiver iq", "receiver iq sample pulse"])
def test_an_array_is_read_along_its_axes(tmp_path, sent, axes):
    cube = sent[:, :, 0].reshape(-1, RECEIVERS, SAMPLES)
    names = axes.split()
    values = np.stack([cube.real, cube.imag], axis=-1) if "iq" in names else cube
    order = [["pulse", "receiver", "sample", "iq"].index(name) for name in names]
    np.savez(tmp_path / "cube.npz", samples=np.transpose(values, order))
    path = described(tmp_path, f'samples = "cube.npz"\naxes = {names}\nreceiver = 2', SWEEP)
    assert abs(measured(path) - range_of(0, 1)) < 0.005


PROFILE_AXES = 'axes = ["pulse", "range"]'


def test_complex_profiles_are_the_signals_that_they_were_made_from(tmp_path, sent):
    """Spectra without a window, echoes of delay tau at +|S| tau: the inverse transform gives the signals."""
    beat = sent[:, :, 0, 0].reshape(-1, SAMPLES)
    np.save(tmp_path / "beat.npy", beat)
    np.save(tmp_path / "profiles.npy", np.fft.fft(beat, axis=1) / SAMPLES)
    signals = process(described(tmp_path, 'samples = "beat.npy"\nrange_zero_m = 1.25', SWEEP))
    profiles = process(described(tmp_path, f'samples = "profiles.npy"\nrange_zero_m = 1.25\n{PROFILE_AXES}', SWEEP))
    np.testing.assert_allclose(profiles.echoes.range_m, signals.echoes.range_m, rtol=1e-12)
    np.testing.assert_allclose(profiles.echoes.power, signals.echoes.power, rtol=1e-9)


@pytest.mark.parametrize("values", ["power", "power_db"])
@pytest.mark.parametrize("zero_m", [0.0, 1.25])
def test_averaged_powers_keep_their_cells_and_levels(tmp_path, sent, values, zero_m):
    beat = sent[:, :, 0, 0].reshape(-1, 4, SAMPLES) * np.hanning(SAMPLES) * 2
    power = (np.abs(np.fft.fft(beat, axis=-1) / SAMPLES) ** 2).mean(axis=1)
    if values == "power":
        np.save(tmp_path / "profiles.npy", power)
    else:
        packed = {"scale_factor": 0.01, "dtype": "int16", "_FillValue": -32768}
        stored = xarray.Dataset({"level": (("pulse", "range"), 10 * np.log10(power))})
        stored.to_netcdf(tmp_path / "profiles.nc", engine="h5netcdf", encoding={"level": packed})
    name = "profiles.npy" if values == "power" else 'profiles.nc"\nvariable = "level'
    recording = f'samples = "{name}"\nvalues = "{values}"\nrange_zero_m = {zero_m}\n{PROFILE_AXES}'
    found = process(described(tmp_path, recording, SWEEP))
    if zero_m == 0:
        # Half a step of 0.01 dB is a share of 0.0012.
        rounding = 1e-9 if values == "power" else 0.0012
        np.testing.assert_allclose(found.spectrum.mean, power.mean(axis=0), rtol=rounding)
    assert abs(np.median(found.echoes.range_m) - (range_of(0, 0) - zero_m)) < 0.02
    with pytest.raises(ScenarioError, match=r"processing.window: has no effect on powers"):
        process(described(tmp_path, recording, SWEEP), {"processing.window": "hann"})


def test_a_background_of_powers_leaves_the_echo_and_the_floor(tmp_path):
    """|leakage + noise|^2 has the mean L + F and the variance 2 L F + F^2; without the background the mean is F."""
    floor, leakage, echo, looks, pulses = 1.0, 100.0, 400.0, 64, 200
    rng = np.random.default_rng(5)
    amplitude = np.zeros(SAMPLES)
    amplitude[[10, 60]] = np.sqrt([leakage, echo])

    def powers(amplitude: np.ndarray) -> np.ndarray:
        noise = rng.normal(size=(pulses, looks, SAMPLES, 2)) * np.sqrt(floor / 2)
        return ((amplitude + noise[..., 0]) ** 2 + noise[..., 1] ** 2).mean(axis=1)

    np.save(tmp_path / "profiles.npy", powers(amplitude))
    np.save(tmp_path / "sky.npy", sky := powers(np.where(np.arange(SAMPLES) == 10, amplitude, 0.0)))
    recording = f'samples = "profiles.npy"\nbackground = "sky.npy"\nvalues = "power"\n{PROFILE_AXES}'
    found = process(described(tmp_path, recording, SWEEP))
    deviation = np.sqrt(2 * leakage * floor + floor**2) / np.sqrt(looks)
    # Two means, of the recording and of the sky; powers below zero count as zero, which adds deviation / sqrt(2 pi).
    assert abs(found.spectrum.mean[10] - floor) < deviation * (5 * np.sqrt(2 / pulses) + 1 / np.sqrt(2 * np.pi))
    assert found.spectrum.mean[60] == pytest.approx(echo + floor, rel=0.02)
    np.testing.assert_allclose(np.delete(found.spectrum.mean, [10, 60]), floor, atol=5 * np.sqrt(2 / pulses / looks))
    cell_m = speed_of_light / (2 * SLOPE * SAMPLES / RATE_HZ)
    (share,) = re.findall(rf"most often at {10 * cell_m:.2f} m \(in (\d+)% of the pulses\)", found.warnings[0])
    assert abs(int(share) / 100 - norm.cdf(-floor / deviation)) < 5 * np.sqrt(0.25 / pulses)
    np.save(tmp_path / "sky.npy", powers(np.zeros(SAMPLES)))
    kept = process(described(tmp_path, recording, SWEEP))
    assert kept.spectrum.mean[10] == pytest.approx(leakage + floor, rel=0.02)
    assert kept.warnings == ("the recording has no poses: its ranges are neither corrected for Doppler nor located",)
    np.save(tmp_path / "sky.npy", sky[:, 1:])
    with pytest.raises(InputFileError, match="has 255 cells a pulse, and the recording 256"):
        process(described(tmp_path, recording, SWEEP))


@pytest.mark.parametrize("real", [True, False])
def test_ranges_count_from_the_radars_zero(tmp_path, sent, real):
    beat = sent[:, :, 0, 0].reshape(-1, SAMPLES)
    np.save(tmp_path / "beat.npy", beat.real if real else beat)
    path = described(tmp_path, 'samples = "beat.npy"\nrange_zero_m = 1.25', SWEEP)
    assert abs(measured(path) - (range_of(0, 0) - 1.25)) < 0.01


def test_a_background_takes_leakage_out_and_dead_samples_are_left_out(tmp_path, sent):
    time_s = np.arange(SAMPLES) / RATE_HZ
    leakage = 60_000 * np.exp(2j * np.pi * 2 * SLOPE * 2.0 / speed_of_light * time_s)
    beat = sent[:, :, 0, 0].reshape(-1, SAMPLES)
    np.save(tmp_path / "sky.npy", np.tile(leakage, (5, 1)))
    spoiled = beat + leakage
    spoiled[:, :20] = 1e6
    np.save(tmp_path / "beat.npy", spoiled)
    taken = 'samples = "beat.npy"\nused_samples = [20, 256]'
    # The target beside the leakage moves its centroid.
    assert abs(measured(described(tmp_path, taken, SWEEP)) - 2.0) < 0.05
    cleaned = process(described(tmp_path, f'{taken}\nbackground = "sky.npy"', SWEEP))
    assert abs(np.median(cleaned.echoes.range_m) - range_of(0, 0)) < 0.005
    (sweep,) = cleaned.sweeps
    assert sweep.bandwidth_hz == pytest.approx(SLOPE * 236 / RATE_HZ)
    assert sweep.carrier_hz == pytest.approx(78.9e9 + SLOPE * 10 / RATE_HZ)


def test_a_run_notices_that_samples_have_changed_and_the_page_shows_what_was_set(tmp_path, sent):
    np.save(tmp_path / "beat.npy", sent[:, :, 0, 0].reshape(-1, SAMPLES))
    path = described(tmp_path, 'samples = "beat.npy"', SWEEP)
    before = identity_of(path, {}, 256)
    assert identity_of(path, {}, 256) == before
    np.save(tmp_path / "beat.npy", sent[:, :, 0, 1].reshape(-1, SAMPLES))
    assert identity_of(path, {}, 256) != before
    page = recording_page(process(path, {"processing.ranging": "peak"}))
    assert "sionna-radar process recording.toml --set &#39;processing.ranging=&#34;peak&#34;&#39; -o again" in page


COLUMNS = "time_s,east_m,north_m,up_m,roll_deg,pitch_deg,heading_deg"


def test_pulses_outside_the_log_are_refused_with_its_span(tmp_path, sent):
    np.save(tmp_path / "beat.npy", sent[:, :, 0, 0].reshape(-1, SAMPLES))
    rows = [f"{t:.2f},{5 * t:.3f},0,104.3,0,0,90" for t in np.arange(0.0, 2.01, 0.1)]
    (tmp_path / "flight.csv").write_text("\n".join([COLUMNS, *rows]))
    poses = '[poses]\nlog = "flight.csv"\nfirst_pulse_s = 1.9\n'
    with pytest.raises(ScenarioError, match=r"poses.first_pulse_s: is at 1.9 s: pulses are at 1.90 to 2.13 s"):
        process(described(tmp_path, 'samples = "beat.npy"', SWEEP + poses))


def readings(folder: Path, name: str, readings: str = "", rest: str = "") -> Path:
    path = folder / "readings.toml"
    path.write_text(f'[readings]\nfile = "{name}"\n{readings}\n{rest}', encoding="utf-8")
    return path


@pytest.mark.parametrize("suffix", ["csv", "npz", "nc"])
@pytest.mark.usefixtures("undrawn")
def test_readings_of_an_altimeter_are_mapped(tmp_path, suffix):
    """Level ground 104.3 m under a flight along 20 m, read 1.5 m too far, with a gap."""
    time_s = 70.0 + np.arange(0.0, 4.0, 0.05)
    range_m = np.where(np.arange(len(time_s)) == 7, np.nan, 105.8)
    if suffix == "csv":
        rows = [f"{t:.2f},{'' if np.isnan(r) else r}" for t, r in zip(time_s, range_m, strict=True)]
        (tmp_path / "alt.csv").write_text("\n".join(["utc,radar_m", *rows]))
    elif suffix == "npz":
        np.savez(tmp_path / "alt.npz", utc=time_s, radar_m=range_m)
    else:
        when = ("reading", time_s, {"units": "seconds since 2020-01-01"})
        stored = xarray.Dataset({"utc": when, "radar_m": ("reading", range_m, {"units": "m"})})
        packed = {"scale_factor": 0.1, "dtype": "int32", "_FillValue": -1}
        stored.to_netcdf(tmp_path / "alt.nc", engine="h5netcdf", encoding={"radar_m": packed})
    flight = [f"{t:.2f},{5 * t:.3f},0,104.3,0,0,90" for t in np.arange(0.0, 6.01, 0.1)]
    (tmp_path / "flight.csv").write_text("\n".join([COLUMNS, *flight]))
    named = 'columns = { time_s = "utc", range_m = "radar_m" }\nrange_zero_m = 1.5'
    poses = '[poses]\nlog = "flight.csv"\nfirst_pulse_s = 1.0\n[dem]\nmethod = "smooth"\nspacing_m = 0.5\n'
    path = readings(tmp_path, f"alt.{suffix}", named, poses)
    found = process(path)
    assert len(found.echoes) == len(time_s) - 1
    assert found.sweeps == ()
    assert found.chirp is None
    np.testing.assert_allclose(found.points.position_m[:, 2], 0.0, atol=1e-6)
    np.testing.assert_allclose(found.points.position_m[[0, -1], 0], [5.0, 5.0 + 5 * 3.95], atol=1e-6)
    assert np.abs(found.dem.height_m[found.dem.filled]).max() < 1e-3
    files = {file.name for file in processed_document(figures=Figures.PNG).write(found, tmp_path / "out")}
    assert {"processed.json", "report.html", "readings.png", "dem.tif", "echoes.csv"} <= files
    for table in ("echoes.csv", "points.csv"):  # readings state no SNR
        first = next(csv.DictReader((tmp_path / "out" / table).read_text().splitlines()))
        assert first["echo_snr_db"] == ""
        assert first["range_m"]
    assert "79 of 80" in recording_page(found)
    with pytest.raises(ScenarioError, match=r"dem.method: needs range profiles"):
        process(path, {"dem.method": "refined"})
    assert "for points along a line set dem.method = 'smooth'" in process(path, {"dem.method": "linear"}).warnings[0]


@pytest.mark.parametrize(
    ("text", "keys", "words"),
    [
        ("time_s,height_m\n0,1\n1,2", "", "has time_s, height_m, and not range_m"),
        ("time_s,range_m\n0,1\n0,2", "", "times that are missing or do not increase"),
        ("time_s,range_m\n0,\n1,", "", "has no range"),
        ("time_s,range_m\n0,5\n1,2", "range_zero_m = 3.0", "one that is not positive"),
        ("time_s,range_m,sigma_m\n0,5,1\n1,2,", "", "a sigma_m that is negative or missing"),
        ("time_s,range_m\n0,5\n1,2,7", "", "cannot be read as a table"),
        ("time_s,range_m\n0,5\n1,2", "axes = []", "unknown key"),
    ],
)
def test_readings_that_do_not_fit_are_one_clear_error(tmp_path, text, keys, words):
    (tmp_path / "alt.csv").write_text(text)
    with pytest.raises((InputFileError, ScenarioError)) as refused:
        process(readings(tmp_path, "alt.csv", keys))
    assert words in str(refused.value)


@pytest.mark.parametrize(
    ("variable", "words"),
    [
        (("reading", [1.0, 2.0], {"units": "ft"}), "range_m has the unit 'ft'; give it in m"),
        (("reading", ["a", "b"]), "columns that are no numbers"),
        ((("reading", "beam"), [[1.0], [2.0]]), "columns of different lengths"),
    ],
)
def test_netcdf_readings_that_do_not_fit_are_one_clear_error(tmp_path, variable, words):
    stored = xarray.Dataset({"time_s": ("reading", [0.0, 1.0]), "range_m": variable})
    stored.to_netcdf(tmp_path / "alt.nc", engine="h5netcdf")
    with pytest.raises(InputFileError, match=words):
        process(readings(tmp_path, "alt.nc"))


def test_swapped_axes_of_a_netcdf_file_are_one_clear_error(tmp_path):
    stored = xarray.Dataset({"samples": (("range", "pulse"), np.ones((SAMPLES, SAMPLES)))})
    stored.to_netcdf(tmp_path / "profiles.nc", engine="h5netcdf")
    recording = f'samples = "profiles.nc"\nvalues = "power"\n{PROFILE_AXES}'
    with pytest.raises(InputFileError, match=r"has the dimensions \['range', 'pulse'\]; set recording.axes to these"):
        process(described(tmp_path, recording, SWEEP))


@pytest.mark.parametrize(("axes", "swapped"), [(["pulse", "sample"], False), (["sample", "pulse"], True)])
def test_swapped_axes_of_an_array_are_told_by_its_spectra(tmp_path, axes, swapped):
    rng, time_s = np.random.default_rng(3), np.arange(SAMPLES) / RATE_HZ
    # Speckle: another amplitude and phase in each pulse.
    amplitude = rng.normal(size=(SAMPLES + 20, 2, 2)) @ np.array([1, 1j])
    tones = np.exp(2j * np.pi * 2 * SLOPE / speed_of_light * np.outer([4.0, 4.5], time_s))
    beat = 100 * amplitude @ tones + rng.normal(size=(SAMPLES + 20, SAMPLES))
    np.save(tmp_path / "beat.npy", beat)
    recording = f'samples = "beat.npy"\naxes = {json.dumps(axes)}'
    told = [w for w in process(described(tmp_path, recording, SWEEP)).warnings if "exchange pulse and sample" in w]
    assert len(told) == swapped


def test_a_capture_of_fewer_frames_than_its_configuration_states_says_so(tmp_path, sent):
    capture(tmp_path, sent)
    recording = 'samples = "adc_data.bin"\nconfig = "profile.cfg"'
    assert not [w for w in process(described(tmp_path, recording)).warnings if "frames" in w]
    whole = (tmp_path / "adc_data.bin").read_bytes()
    (tmp_path / "adc_data.bin").write_bytes(whole[: len(whole) * (FRAMES - 1) // FRAMES])
    words = f"adc_data.bin: {FRAMES - 1} whole frames are read, of the {FRAMES} that its configuration states"
    assert any(words in warning for warning in process(described(tmp_path, recording)).warnings)


@pytest.mark.parametrize("written", [2, 4])
@pytest.mark.parametrize("read", [2, 4])
@pytest.mark.parametrize("moving", [True, False])
def test_the_order_of_a_capture_is_told_by_the_images_of_moving_echoes(tmp_path, sent, written, read, moving):
    """Speckled ground over a fifth of the ranges, or noise about an echo that stands still, which tells nothing."""
    beat = np.tile(sent, (6, 1, 1, 1, 1))
    rng, shape = np.random.default_rng(written), beat.shape[:3]
    if moving:
        gain = (rng.normal(size=(*shape, 20)) + 1j * rng.normal(size=(*shape, 20))) * 300
        cells = np.exp(2j * np.pi * np.outer(np.arange(20, 40), np.arange(SAMPLES)) / SAMPLES)
        phase = np.exp(2j * np.pi * rng.uniform(size=RECEIVERS))
        beat += (gain @ cells)[:, :, :, None, :] * phase[:, None]
    capture(tmp_path, beat, written)
    recording = f'samples = "adc_data.bin"\nconfig = "profile.cfg"\nlanes = {read}'
    told = [w for w in process(described(tmp_path, recording)).warnings if f"recording.lanes = {written}" in w]
    assert len(told) == (moving and read != written)


def test_a_description_has_samples_or_readings(tmp_path):
    path = tmp_path / "both.toml"
    path.write_text('[recording]\nsamples = "a.npy"\n[readings]\nfile = "b.csv"\n')
    with pytest.raises(ScenarioError, match=r"recording: give \[recording\] with samples or \[readings\]"):
        process(path)


def test_a_log_gives_points_and_a_map(tmp_path):
    """Looking straight down from 4.3 m over level ground, along 20 m."""
    count = 400
    time_s = np.arange(SAMPLES) / RATE_HZ
    rng = np.random.default_rng(2)
    beat = 6000 * np.exp(2j * np.pi * 2 * SLOPE * 4.3 / speed_of_light * time_s)
    np.save(
        tmp_path / "beat.npy", beat + 20 * (rng.normal(size=(count, SAMPLES)) + 1j * rng.normal(size=(count, SAMPLES)))
    )
    # Attitudes begin half a second after positions.
    rows = [f"{t:.2f},{5 * t:.3f},0,104.3,{',,' if t < 0.45 else '0,0,90'}" for t in np.arange(0.0, 6.01, 0.1)]
    (tmp_path / "flight.csv").write_text("\n".join([COLUMNS, *rows]))
    poses = '[poses]\nlog = "flight.csv"\nfirst_pulse_s = 1.0\n'
    found = process(described(tmp_path, 'samples = "beat.npy"', SWEEP + poses), {"dem.spacing_m": 0.5})
    assert found.points is not None
    np.testing.assert_allclose(found.points.position_m[[0, -1], 0], [5.0, 5.0 + 5 * 3.99], atol=0.02)
    assert np.abs(found.points.position_m[:, 2] - 100.0).max() < 0.03


@pytest.mark.parametrize(
    ("recording", "rest", "words"),
    [
        ('samples = "none.npy"', SWEEP, "does not exist"),
        ('samples = "beat.npy"', "", "sweep: is missing"),
        ('samples = "adc_data.bin"', "", "recording.config: is missing"),
        ('sample = "beat.npy"', SWEEP, "Did you mean samples"),
        ('samples = "beat.npy"\naxes = ["pulse", "receiver", "sample"]', SWEEP, "recording.axes names"),
        ('samples = "beat.npy"\nreceiver = 2', SWEEP, "has 1 receivers"),
        ('samples = "beat.npy"\nused_samples = [20, 900]', SWEEP, "give first and end within 256"),
        (f'samples = "beat.npy"\n{PROFILE_AXES}\nvalues = "power"', SWEEP, "holds complex128, and powers are real"),
        (f'samples = "real.npy"\n{PROFILE_AXES}', SWEEP, "set recording.values = 'power'"),
        (f'samples = "real.npy"\n{PROFILE_AXES}\nvalues = "power"', SWEEP, "holds negative powers"),
        ('samples = "beat.npy"\nvalues = "power"', SWEEP, "applies to range profiles only; name their axis range"),
        ('samples = "beat.npy"\naxes = ["pulse", "sample", "range"]', SWEEP, "and either sample or range among them"),
        ('samples = "adc_data.bin"\nconfig = "profile.cfg"\ntransmitter = 3', "", "no chirp of a frame"),
        ('samples = "cut.bin"\nconfig = "profile.cfg"', "", "get the whole file"),
        ('samples = "adc_data.bin"\nconfig = "empty.cfg"', "", "has no channelCfg"),
        ('samples = "text.npy"', SWEEP, "cannot be read as a NumPy file"),
        ('samples = "beat.npy"\nbackground = "real.npy"', SWEEP, "holds float64, and the recording complex128"),
        ('samples = "beat.npy"\nbackground = "none.npy"', SWEEP, "does not exist"),
        ('samples = "beat.npy"\nrange_zero_m = 500.0', SWEEP, "is beyond the 12.5 m that the samples reach"),
        ('samples = "beat.npy"', SWEEP.replace("100.0", "2e4"), "lasts 0.0512 ms with 256 samples, and pulses follow"),
        (f'samples = "loud.npy"\n{PROFILE_AXES}\nvalues = "power_db"', SWEEP, "holds levels of no power in dB"),
        ('samples = "adc_data.bin"\nconfig = "idle.cfg"', "", "loops of a frame: 0 is not within 1 to 65536"),
        ('samples = "adc_data.bin"\nconfig = "short.cfg"', "", "adcCfg has 1 values"),
        ('samples = "adc_data.bin"\nconfig = "other.cfg"', "", "profile 7.0, which is not defined"),
        ('samples = "adc_data.bin"\nconfig = "two.cfg"', "", "the chirps of a frame differ in adc_start_us, idle_us"),
        ('samples = "adc_data.bin"\nconfig = "nan.cfg"', "", "size of the slope (MHz/us): nan is not within"),
        ('samples = "adc_data.bin"\nconfig = "profile.cfg"', SWEEP, "sweep: applies to arrays only"),
        (
            f'samples = "adc_data.bin"\nconfig = "profile.cfg"\n{PROFILE_AXES}',
            "",
            "recording.axes: applies to arrays only",
        ),
    ],
)
def test_what_does_not_fit_is_one_clear_error(tmp_path, sent, recording, rest, words):
    capture(tmp_path, sent[:1])
    (tmp_path / "cut.bin").write_bytes((tmp_path / "adc_data.bin").read_bytes()[:-100])
    (tmp_path / "empty.cfg").write_text("sensorStop\n")
    (tmp_path / "idle.cfg").write_text(CONFIG.replace(f"frameCfg 0 1 {LOOPS}", "frameCfg 0 1 0"))
    (tmp_path / "short.cfg").write_text(CONFIG.replace("adcCfg 2 1", "adcCfg 2"))
    (tmp_path / "other.cfg").write_text(CONFIG.replace("chirpCfg 0 0 0", "chirpCfg 0 0 7"))
    (tmp_path / "two.cfg").write_text(CONFIG.replace("chirpCfg 1 1 0 0 0 0 0", "chirpCfg 1 1 0 0 0 3 2"))
    (tmp_path / "nan.cfg").write_text(CONFIG.replace("60 1", "nan 1"))
    (tmp_path / "text.npy").write_text("no array")
    np.save(tmp_path / "beat.npy", sent[:, :, 0, 0].reshape(-1, SAMPLES))
    np.save(tmp_path / "real.npy", sent[:, :, 0, 0].reshape(-1, SAMPLES).real)
    np.save(tmp_path / "loud.npy", np.full((24, SAMPLES), 1e5))
    (tmp_path / "profile.cfg").write_text(CONFIG)
    with pytest.raises((InputFileError, ScenarioError)) as refused:
        process(described(tmp_path, recording, rest))
    assert words in str(refused.value)
