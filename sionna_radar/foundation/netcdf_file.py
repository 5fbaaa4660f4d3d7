"""Variables of netCDF files of images."""

import numpy as np
from scipy.io import netcdf_file


def write_variable(
    file: netcdf_file, name: str, values: np.ndarray, dimensions: tuple[str, ...], units: str, meaning: str
) -> None:
    """Write an array over existing dimensions, with its unit and its meaning."""
    variable = file.createVariable(name, values.dtype, dimensions)
    variable[:] = values
    variable.units, variable.long_name = units, meaning
