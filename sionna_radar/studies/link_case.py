"""The mean spectrum of level ground under a radar, in closed form: one material at one incidence in one rain.

The beam's parts over the plane (`plane_echo_parts`) are each at a range; what fills the air before them is moved in
range by its own speed; the window leaves its response of each.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float, Int
from scipy.signal import fftconvolve

from sionna_radar.flight.pulses import Pose
from sionna_radar.radar.equation import PlaneEcho, plane_echo_parts
from sionna_radar.scenario import parse_scenario
from sionna_radar.scenario.weather import WeatherTable
from sionna_radar.studies.link_floors import LEAKAGE, floors_of
from sionna_radar.studies.link_receiver import BuiltReceiver
from sionna_radar.surfaces.radar_material import as_radar_material
from sionna_radar.survey.preparation import Prepared, prepare
from sionna_radar.tracing.effects.atmosphere import build_atmosphere, build_weather
from sionna_radar.tracing.effects.volume_echo import VolumeEcho
from sionna_radar.weather.conditions import Weather
from sionna_radar.weather.path import two_way_attenuation
from sionna_radar.weather.volume import volume_of

# Steps of the closed form in a bin of the spectrum, and how far the window's response is followed, in range cells.
STEPS_PER_BIN, FOLLOWED_CELLS = 4, 24
# So slow that no echo is moved by its Doppler shift.
SPEED_MPS = 0.01
# Range at which the beam's direction is worked out, and speeds that stand for those of all drops.
NOMINAL_M, FALL_SPEEDS = 10.0, 32


@dataclass(frozen=True, kw_only=True)
class GroundCase:
    """One material at one incidence in one rain.

    prepared: the survey whose radar it is.
    """

    prepared: Prepared
    material: str
    incidence_deg: float
    rain_mm_per_h: float

    @cached_property
    def terms(self) -> dict[str, Float[np.ndarray, " bin"]]:
        """Mean powers in the bins of the calibrated spectrum without any echo, by what they come from."""
        given = self.prepared
        found = floors_of(given.local.radar, given.receiver, given.detector.analyser)
        if given.local.processing.leakage == "subtract":
            found.pop(LEAKAGE, None)
        return found

    @cached_property
    def floor(self) -> Float[np.ndarray, " bin"]:
        """All of them together."""
        return np.sum(list(self.terms.values()), axis=0)

    @cached_property
    def weather(self) -> WeatherTable:
        """The scenario's weather, with even rain of this rate."""
        even = {"rain_rate_mm_per_h": self.rain_mm_per_h, "rain_field": None, "rain_cell": None}
        return self.prepared.local.weather.model_copy(update=even)

    @cached_property
    def _weather(self) -> Weather:
        return build_weather(self.weather, self.prepared.receiver.chirp.carrier_hz)

    @cached_property
    def _pose(self) -> Pose:
        """The radar over the plane."""
        return self.over_plane(NOMINAL_M, 2).flight.pulses(np.zeros(1, dtype=np.int64)).true

    @cached_property
    def _loss_db_per_km(self) -> float:
        """One-way specific attenuation along the beam."""
        air = build_atmosphere(self.weather, self.prepared.antenna, self.prepared.receiver.chirp, 0)
        return float(air.attenuation_db_per_km(self._pose)[0])

    @cached_property
    def _from_one_metre(self) -> PlaneEcho:
        """The echo of the plane without the air, from a height of one metre."""
        given, backscatter = self.prepared, self.prepared.scene.scene.materials[self.material]
        wavelength_m, tilt_rad = given.receiver.chirp.wavelength_m, float(np.deg2rad(self.incidence_deg))
        return plane_echo_parts(given.antenna, as_radar_material(backscatter).co_polar, wavelength_m, 1.0, tilt_rad)

    def expected(self, range_m: float) -> "Expected":
        """Return the mean spectrum of ground at a range on the beam's axis, and of what is in the air before it."""
        given, analyser = self.prepared, self.prepared.detector.analyser
        # From a height h the ranges are h times those from one metre, and the powers over h^2.
        parts, height_m = self._from_one_metre, range_m * float(np.cos(np.deg2rad(self.incidence_deg)))
        part_m = parts.range_m * height_m
        passed = self._passed(part_m) * given.receiver.transmit_power_w / height_m**2
        step_m, steps, scale = analyser.bin_m / STEPS_PER_BIN, self.built.reach * STEPS_PER_BIN, self.built.scale
        at = np.minimum(np.round(part_m * scale / step_m).astype(np.int64), steps)
        ground = np.bincount(at, parts.power * passed, minlength=steps + 1)[:steps]
        met = np.cumsum(np.bincount(at, parts.beam_share, minlength=steps + 1)[:steps])
        air = self._in_air((np.arange(steps) + 0.5) * step_m / scale, 1 - met) * given.receiver.transmit_power_w
        reaching, floating = self._in_bins(ground), self._in_bins(air)
        return Expected(ground=self._sampled(reaching), clutter=self._sampled(floating), reaching=reaching + floating)

    @cached_property
    def built(self) -> BuiltReceiver:
        """The receiver."""
        return BuiltReceiver(self.prepared.receiver, self.prepared.detector.analyser)

    def _sampled(self, power: Float[np.ndarray, " reach"]) -> Float[np.ndarray, " bin"]:
        """Return the spectrum that is read of echoes, which have no beats below zero."""
        held = np.append(power, 0.0)
        return self.built.sampled(lambda number: held[np.where((number >= 0) & (number < len(power)), number, -1)])

    @cached_property
    def _volume(self) -> tuple[VolumeEcho, Float[np.ndarray, " speed"]] | None:
        """What fills the air, with speeds along the beam that stand for all of it; None for nothing."""
        volume = volume_of(self._weather)
        if volume is None:
            return None
        boresight, quantile = self._pose.boresight[0], (np.arange(FALL_SPEEDS) + 0.5) / FALL_SPEEDS
        fall_mps = volume.fall_mps(np.zeros((FALL_SPEEDS, 2)), quantile)
        receding_mps = -boresight[2] * fall_mps + boresight @ np.array(self._weather.wind_mps)
        return VolumeEcho(volume, self.prepared.antenna, self.prepared.receiver.chirp, 0), receding_mps

    @cached_property
    def response(self) -> Float[np.ndarray, " step"]:
        """Response of the window in fine steps of range, one at its peak."""
        analyser = self.prepared.detector.analyser
        per_cell = analyser.zero_padding * STEPS_PER_BIN
        response = analyser.response(FOLLOWED_CELLS * per_cell, per_cell)
        return response / response.max()

    def _in_bins(self, fine: Float[np.ndarray, " step"]) -> Float[np.ndarray, " bin"]:
        """Return the mean spectrum of powers in fine steps of range: each leaves the window's response."""
        spectrum: Float[np.ndarray, " step"] = fftconvolve(fine, self.response, mode="same")
        return np.maximum(spectrum[::STEPS_PER_BIN], 0.0)

    def _in_air(
        self, range_m: Float[np.ndarray, " step"], open_share: Float[np.ndarray, " step"]
    ) -> Float[np.ndarray, " step"]:
        """Return the mean echo of rain, snow, fog or dust by range, as the sweep shows it: particles move.

        open_share: share of the beam that has met no ground up to each range.
        """
        step_m, shown = float(range_m[1] - range_m[0]), np.zeros(len(range_m))
        if self._volume is None:
            return shown
        echo, receding_mps = self._volume
        cell = np.minimum((range_m / echo.cell_m).astype(np.int64), len(echo.cell_power) - 1)
        # Nothing in the air is traced beyond the greatest range.
        traced = range_m < len(echo.cell_power) * echo.cell_m
        power = traced * echo.cell_power[cell] * (step_m / echo.cell_m) * open_share * self._passed(range_m)
        for shift in np.round(self.prepared.receiver.chirp.doppler_range_m(receding_mps) / step_m).astype(np.int64):
            first, last = max(shift, 0), min(len(shown) + shift, len(shown))
            shown[first:last] += power[first - shift : last - shift] / FALL_SPEEDS
        return shown

    def _passed(self, range_m: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """Return the share of an echo's power that the air lets pass, both ways, and a wet radome."""
        if self._weather.clear:
            return np.ones(len(range_m))
        wet = 10 ** (-self._weather.wet_radome_loss_db(self.rain_mm_per_h) / 10)
        return wet * two_way_attenuation(range_m, self._loss_db_per_km)

    def level(self, expected: "Expected") -> float:
        """Return the level that the CFAR reads around the strongest bin, from all that is there.

        Its own scatter is taken for that of noise; in even noise the level of means is that noise, for each kind of
        CFAR.
        """
        level, _ = self.prepared.detector.cfar.noise_level((expected.ground + expected.clutter + self.floor)[None])
        return float(max(level[0, expected.peak], np.finfo(float).tiny))

    def over_plane(self, range_m: float, pulses: int) -> Prepared:
        """Return a survey by the radar that all but hovers over level ground of the material."""
        scenario = self.prepared.scenario
        kept = {"seed", "materials", "radar", "processing", "tracing"}
        document = scenario.model_dump(include=kept, exclude_unset=True)
        tilt, size_m = np.deg2rad(self.incidence_deg), 4 * range_m + 100
        radar = document["radar"]
        plane = {
            **document,
            "description": "link budget",
            "terrain": {
                "kind": "flat",
                "size_m": [size_m, size_m],
                "spacing_m": size_m / 20,
                "material": self.material,
            },
            "platform": {
                "altitude_m": range_m * float(np.cos(tilt)),
                "speed_mps": SPEED_MPS,
                "length_m": SPEED_MPS * (pulses + 1) / scenario.radar.mean_rate_hz,
            },
            "radar": {**radar, "scan": {"mode": "fixed", "incidence_deg": self.incidence_deg}},
            "weather": self.weather.model_dump(exclude_unset=True),
            "tracing": {**document.get("tracing", {}), "speckle": "per_pulse", "decorrelation_time_s": None},
            "dem": {"method": "linear"},
        }
        return prepare(parse_scenario(plane))


@dataclass(frozen=True)
class Expected:
    """Mean spectra of the ground, and of what is in the air before it.

    reaching: both together in front of the filters, beyond the sampled band too.
    """

    ground: Float[np.ndarray, " bin"]
    clutter: Float[np.ndarray, " bin"]
    reaching: Float[np.ndarray, " reach"]

    @property
    def peak(self) -> int:
        """The strongest bin of the ground."""
        return int(np.argmax(self.ground))

    @property
    def strongest(self) -> tuple[float, float]:
        """Power of ground and of clutter there."""
        return float(self.ground[self.peak]), float(self.clutter[self.peak])

    @property
    def half_power(self) -> Int[np.ndarray, " bin"]:
        """The bins within 3 dB of the strongest."""
        return np.flatnonzero(self.ground > self.ground[self.peak] / 2)
