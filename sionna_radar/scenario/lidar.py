"""Table of the lidar: `[lidar]`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

from sionna_radar.scenario.presets import LIDAR_PRESETS
from sionna_radar.scenario.table import Conflicts, NonNegative, Real, Table, one_of

# Keys of a lidar as built alone.
AS_BUILT_KEYS = (
    *("preset", "pulse_energy_nj", "receiver_aperture_mm", "efficiency", "excess_noise", "sun", "filter_nm"),
    *("field_of_view_mrad", "second_divergence_mrad", "false_alarm_probability", "max_returns", "rays"),
    "leaf_reflectivity",
)


class LidarTable(Table):
    """A range sensor on the radar's scan.

    The ideal one measures the range along the beam axis, exact but for white noise. Without wavelength_nm it ignores
    the weather; with it the weather's extinction and echoes act on its pulses. That as built digitises the echoes of
    the whole beam off ground, plants and air, with the noise of its receiver.
    """

    model: Literal["ideal", "as_built"] = "ideal"
    """Model of the lidar: "ideal", or a waveform lidar "as_built" with beam divergence and receiver noise."""
    preset: Annotated[str, one_of(LIDAR_PRESETS)] | None = None
    """Published lidar whose values are used for keys that are not given; `sionna-radar presets` lists them."""
    range_noise_m: NonNegative = 0.0
    """Standard deviation of a range; of a lidar as built beside that of its signal."""
    wavelength_nm: Literal[905, 1550] | None = None
    """Wavelength of the light."""
    clear_range_m: Annotated[Real, Field(ge=1, le=1e5)] = 200.0
    """Maximum range in clear air to a Lambertian target of 10 % at normal incidence; it sets the receiver's threshold,
    and of a lidar as built the detector noise: there, in full sunlight, it detects half of the pulses."""
    least_reflectivity: Annotated[Real, Field(ge=0, le=1)] = 0.001
    """Reflectivity of the weakest target that is reported, however near it is."""
    returns: Literal["first", "last", "all"] = "first"
    """Return of a pulse that gives its range: the first or the last one; of a lidar as built also "all"."""
    max_returns: Annotated[int, Field(strict=True, ge=1, le=15)] = 5
    """Number of returns of a pulse that are kept with returns = "all": the strongest."""
    pulse_ns: Annotated[Real, Field(ge=0.01, le=1000)] = 5.0
    """Length of the pulse, at half of its peak power."""
    pulse_energy_nj: Annotated[Real, Field(ge=1e-3, le=1e9)] = 300.0
    """Energy of the pulse."""
    divergence_mrad: Annotated[Real, Field(ge=0, le=100)] = 1.0
    """Full width of the beam, at 1 / e^2 of its intensity."""
    second_divergence_mrad: Annotated[Real, Field(ge=0, le=100)] | None = None
    """Full width of the beam up and down, divergence_mrad being that to left and right. Default: round."""
    aperture_mm: Annotated[Real, Field(ge=1, le=1000)] = 20.0
    """Width of the beam at the lidar."""
    receiver_aperture_mm: Annotated[Real, Field(ge=1, le=1000)] = 25.0
    """Diameter of the receiver."""
    efficiency: Annotated[Real, Field(ge=1e-4, le=1)] = 0.3
    """Photoelectrons per photon at the receiver's aperture: transmission of the optics times quantum efficiency."""
    excess_noise: Annotated[Real, Field(ge=1, le=100)] = 3.0
    """Excess noise factor of the detector: variance over that of shot noise alone."""
    sun: Annotated[Real, Field(ge=0, le=2)] = 1.0
    """Sunlight on the ground, over that of a high sun in a clear sky; 0 at night."""
    filter_nm: Annotated[Real, Field(ge=0.01, le=1000)] = 20.0
    """Width of the optical filter in front of the detector."""
    field_of_view_mrad: Annotated[Real, Field(gt=0, le=1000)] | None = None
    """Full width of the receiver's field of view, which is round. Default: twice the beam along each axis."""
    false_alarm_probability: Annotated[Real, Field(ge=1e-15, le=0.5)] = 1e-4
    """Expected number of false alarms by noise in a pulse."""
    rays: Annotated[int, Field(strict=True, ge=1, le=4096)] = 32
    """Number of rays over the beam."""
    near_range_m: Annotated[Real, Field(ge=0.1, le=1000)] = 1.0
    """Least range of a detection, from which on the receiver sees the whole beam."""
    ground_reflectivity: Annotated[Real, Field(gt=0, le=1)] = 0.3
    """Lambertian reflectivity of the ground at the wavelength."""
    reflectivities: dict[str, Annotated[Real, Field(ge=0, le=1)]] = {}
    """Reflectivities of other surfaces by the names of their materials; 0 for calm water, which mirrors the light
    away."""
    leaf_reflectivity: Annotated[Real, Field(ge=0, le=1)] = 0.4
    """Lambertian reflectivity of leaves at the wavelength."""

    @model_validator(mode="before")
    @classmethod
    def _with_preset(cls, values: Any) -> Any:
        known = isinstance(values, Mapping) and isinstance(values.get("preset"), str)
        if known and values["preset"] in LIDAR_PRESETS:
            given = {key: value for key, value in values.items() if value is not None}
            preset = dict(LIDAR_PRESETS[values["preset"]].keys)
            if given.get("returns", preset["returns"]) != "all":
                preset.pop("max_returns")
            return {**preset, **given}
        return values

    def differing(self) -> dict[str, Any]:
        """Return the keys that differ from their defaults, and all that the preset sets."""
        of_preset = LIDAR_PRESETS[self.preset].keys if self.preset else {}
        kept = {key: value for key, value in self.model_dump(mode="json").items() if key in of_preset}
        return {**super().differing(), **kept}

    def _conflicts(self) -> Conflicts:
        changed = self.changed(*(key for key in type(self).model_fields if key != "range_noise_m"))
        if changed and self.wavelength_nm is None:
            yield changed[0], f"{getattr(self, changed[0])} has no effect without wavelength_nm; give 905 or 1550"
        for key in self.changed(*AS_BUILT_KEYS) if self.model == "ideal" else ():
            yield key, f"{getattr(self, key)} has no effect on model = 'ideal'; remove it, or set model = 'as_built'"
        if self.model == "ideal" and self.returns == "all":
            yield "returns", "'all' is of a lidar as built; give 'first' or 'last', or set model = 'as_built'"
        if self.returns != "all" and self.changed("max_returns"):
            yield "max_returns", f"{self.max_returns} has no effect on returns = {self.returns!r}; set returns = 'all'"
