"""The range sensor that a radar is compared with: `[lidar]`."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from sionna_radar.scenario.table import NonNegative, Real, Table, refuse


class LidarTable(Table):
    """A range sensor on the radar's scan: the range along the beam axis, exact but for white noise.

    Without wavelength_nm it sees through everything. With it the weather's extinction and echoes act on its pulses:
    """

    range_noise_m: NonNegative = 0.0
    """standard deviation of a range."""
    wavelength_nm: Literal[905, 1550] | None = None
    """of the light."""
    clear_range_m: Annotated[Real, Field(ge=1, le=1e5)] = 200.0
    """in clear air, of a Lambertian target of 10 % at right angles: what sets the receiver's threshold."""
    least_reflectivity: Annotated[Real, Field(ge=0, le=1)] = 0.001
    """of the weakest target that is reported, however near it is."""
    returns: Literal["first", "last"] = "first"
    """the first or the last one of a pulse is its range."""
    pulse_ns: Annotated[Real, Field(ge=0.01, le=1000)] = 5.0
    """length of the pulse."""
    divergence_mrad: Annotated[Real, Field(ge=0, le=100)] = 1.0
    """full width of the beam."""
    aperture_mm: Annotated[Real, Field(ge=1, le=1000)] = 20.0
    """width of the beam at the lidar."""
    near_range_m: Annotated[Real, Field(ge=0.1, le=1000)] = 1.0
    """nothing closer is detected; from there on the receiver sees the whole beam."""
    ground_reflectivity: Annotated[Real, Field(gt=0, le=1)] = 0.3
    """Lambertian, of the ground at the wavelength."""
    reflectivities: dict[str, Annotated[Real, Field(ge=0, le=1)]] = {}
    """of other surfaces, by the names of their materials; 0 for calm water, which mirrors the light away."""

    @model_validator(mode="after")
    def _of_light(self) -> LidarTable:
        fields = type(self).model_fields
        changed = [k for k in fields if k != "range_noise_m" and getattr(self, k) != fields[k].default]
        if changed and self.wavelength_nm is None:
            raise refuse(
                changed[0], f"{getattr(self, changed[0])} has no effect without wavelength_nm; give 905 or 1550"
            )
        return self
