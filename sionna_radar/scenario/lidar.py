"""The range sensor that a radar is compared with: `[lidar]`."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from sionna_radar.scenario.table import NonNegative, Real, Table, refuse


class LidarTable(Table):
    """A range sensor on the radar's scan: the range along the beam axis, exact but for white noise.

    Without wavelength_nm it sees through everything. With it the weather's extinction and echoes act on its pulses:
    clear_range_m: in clear air, of a Lambertian target of 10 % at right angles: what sets the receiver's threshold.
    least_reflectivity: of the weakest target that is reported, however near it is.
    returns: the first or the last one of a pulse is its range.
    pulse_ns: length of the pulse.
    divergence_mrad: full width of the beam.
    aperture_mm: width of the beam at the lidar.
    near_range_m: nothing closer is detected; from there on the receiver sees the whole beam.
    ground_reflectivity: Lambertian, of the ground at the wavelength.
    reflectivities: of other surfaces, by the names of their materials; 0 for calm water, which mirrors the light away.
    range_noise_m: standard deviation of a range.
    wavelength_nm: of the light.
    """

    range_noise_m: NonNegative = 0.0
    wavelength_nm: Literal[905, 1550] | None = None
    clear_range_m: Annotated[Real, Field(ge=1, le=1e5)] = 200.0
    least_reflectivity: Annotated[Real, Field(ge=0, le=1)] = 0.001
    returns: Literal["first", "last"] = "first"
    pulse_ns: Annotated[Real, Field(ge=0.01, le=1000)] = 5.0
    divergence_mrad: Annotated[Real, Field(ge=0, le=100)] = 1.0
    aperture_mm: Annotated[Real, Field(ge=1, le=1000)] = 20.0
    near_range_m: Annotated[Real, Field(ge=0.1, le=1000)] = 1.0
    ground_reflectivity: Annotated[Real, Field(gt=0, le=1)] = 0.3
    reflectivities: dict[str, Annotated[Real, Field(ge=0, le=1)]] = {}

    @model_validator(mode="after")
    def _of_light(self) -> LidarTable:
        fields = type(self).model_fields
        given = [k for k in fields if k != "range_noise_m" and getattr(self, k) != fields[k].default]
        if given and self.wavelength_nm is None:
            raise refuse(given[0], f"{getattr(self, given[0])} has no effect without wavelength_nm; give 905 or 1550")
        return self
