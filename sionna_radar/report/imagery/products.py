"""The folder of a side-looking survey's images: numbers, scenario, netCDF files and figures.

The netCDF files are of the classic format with 64-bit offsets, which every netCDF reader accepts (xarray's
`open_dataset` among them); it has no complex numbers, so an amplitude is stored as its real and imaginary parts.
Following the CF conventions, variables name their `coordinates` and, if georeferenced, their `grid_mapping`.
"""

from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from pyproj import CRS, Transformer
from scipy.io import netcdf_file

from sionna_radar.foundation.versions import versions
from sionna_radar.imaging.grid import PixelGrid
from sionna_radar.imaging.sar import SarImage
from sionna_radar.report.folder import strict_json, write_folder, write_text
from sionna_radar.report.imagery.figures import draw_all
from sionna_radar.scenario import to_toml
from sionna_radar.studies.images import Imagery, Reflector, Response

MARKER = "image.json"
# Variable that holds the CRS, under the name that CF gives it.
GRID_MAPPING = "crs"


def write_imagery(imagery: Imagery, directory: Path) -> list[Path]:
    """Write `image.json`, the images as netCDF and the figures into a directory, all or nothing; return the files.

    Raises
    ------
    OutputError
        The directory holds something else, or cannot be written; see `write_folder`.

    """
    return write_folder(directory, MARKER, lambda folder: _fill(imagery, folder))


def _fill(imagery: Imagery, directory: Path) -> None:
    write_text(directory / MARKER, strict_json(image_summary(imagery)))
    write_text(directory / "scenario.toml", to_toml(imagery.scenario))
    write_slar(directory / "slar.nc", imagery)
    if imagery.focused is not None:
        write_sar(directory / "sar.nc", imagery, imagery.focused)
    draw_all(imagery, directory / "figures")


def image_summary(imagery: Imagery) -> dict[str, Any]:
    """Return what was imaged and at what resolution, in strict JSON form.

    Half-power widths in metres: `theory` in the middle of the beam, and for every point target at its position next to
    `measured`, which is None if the target is not isolated, not steady or not bright enough.
    """
    strip, focused = imagery.strip, imagery.focused
    document: dict[str, Any] = {
        "scenario": imagery.scenario.model_dump(mode="json"),
        "seed": imagery.scenario.seed,
        "pulses": imagery.pulses,
        "strip": {
            "side": strip.side,
            "length_m": strip.length_m,
            "near_ground_range_m": strip.near_m,
            "far_ground_range_m": strip.far_m,
            "ground_height_m": strip.height_m,
            "middle_slant_range_m": strip.middle_range_m,
        },
        "slar": {
            "stretches": len(imagery.slant.along_m),
            "stretch_m": float(np.diff(imagery.slant.along_m[:2])[0]),
            "theory": {"along_m": imagery.slar.along_m, "slant_range_m": imagery.slar.across_m},
        },
        "sar": None,
        "reflectors": [_reflector(reflector) for reflector in imagery.reflectors],
        "versions": versions(),
    }
    if focused is not None and imagery.sar is not None:
        document["sar"] = {
            "rows": focused.grid.shape[0],
            "columns": focused.grid.shape[1],
            "pixel_along_m": float(np.diff(focused.grid.along_m[:2])[0]),
            "pixel_ground_range_m": float(np.diff(focused.grid.across_m[:2])[0]),
            "aperture_deg": float(np.rad2deg(focused.aperture.width_rad)),
            "window": focused.window_name,
            "theory": {"along_m": imagery.sar.along_m, "ground_range_m": imagery.sar.across_m},
        }
    return document


def _reflector(reflector: Reflector) -> dict[str, Any]:
    return {
        "position_m": reflector.position_m,
        "along_m": reflector.place.along_m,
        "ground_range_m": reflector.place.ground_m,
        "slant_range_m": reflector.place.slant_range_m,
        "slar": _response(reflector.slar, "slant_range_m"),
        "sar": None if reflector.sar is None else _response(reflector.sar, "ground_range_m"),
    }


def _response(response: Response, across: str) -> dict[str, Any]:
    return {
        name: None if widths is None else {"along_m": widths["along_m"], across: widths["across_m"]}
        for name, widths in asdict(response).items()
    }


def write_slar(path: Path, imagery: Imagery) -> None:
    """Write the slant-range image: power against along-track position and slant range."""
    image = imagery.slant
    track = imagery.strip.pixels(image.along_m, np.zeros(1))
    with netcdf_file(path, "w", version=2) as file:
        _describe(file, imagery, "Slant-range image of a side-looking radar")
        _axis(file, "along", image.along_m, "position along the track from the first pulse")
        _axis(file, "slant_range", image.range_m, "slant range, corrected for Doppler")
        _variable(file, "power", image.power, ("along", "slant_range"), "W", "received power, mean over an interval")
        height = image.height_m + _origin_m(imagery)[2]
        _variable(file, "radar_height", height, ("along",), "m", "mean height of the radar, as measured")
        _places(file, imagery, track, row=0)


def write_sar(path: Path, imagery: Imagery, image: SarImage) -> None:
    """Write the focused image: complex amplitude against ground range and along-track position."""
    pixel = ("ground_range", "along")
    with netcdf_file(path, "w", version=2) as file:
        _describe(file, imagery, "Stripmap SAR image, back-projected on level ground")
        _axis(file, "along", image.grid.along_m, "position along the track from below the first pulse")
        _axis(file, "ground_range", image.grid.across_m, "distance from the track on the ground")
        _variable(file, "amplitude_real", image.amplitude.real, pixel, "W^0.5", "real part of the amplitude")
        _variable(file, "amplitude_imag", image.amplitude.imag, pixel, "W^0.5", "imaginary part of the amplitude")
        _variable(file, "pulses", image.pulses.astype(np.int32), pixel, "1", "number of pulses focused into the pixel")
        _places(file, imagery, image.grid)


def _describe(file: netcdf_file, imagery: Imagery, title: str) -> None:
    file.Conventions, file.title, file.source = "CF-1.8", title, "sionna-radar"
    file.history = f"simulated with seed {imagery.scenario.seed}"
    # scipy encodes text as ASCII, and writes bytes unchanged.
    file.scenario = to_toml(imagery.scenario).encode()
    file.side = imagery.strip.side
    file.ground_height_m = imagery.strip.height_m + _origin_m(imagery)[2]
    if imagery.georeference:
        file.crs_wkt = imagery.georeference.crs_wkt.encode()
        mapping = file.createVariable(GRID_MAPPING, "i4", ())
        for name, value in CRS.from_wkt(imagery.georeference.crs_wkt).to_cf().items():
            setattr(mapping, name, value.encode() if isinstance(value, str) else value)


def _places(file: netcdf_file, imagery: Imagery, grid: PixelGrid, row: int | None = None) -> None:
    """Write the map coordinates of all pixels, or of one row of them, and name them as coordinates of the variables."""
    place = grid.position_m[..., :2] + np.array(_origin_m(imagery)[:2])
    dimensions: tuple[str, ...] = ("ground_range", "along")
    if row is not None:
        place, dimensions = place[row], dimensions[1:]
    measured = [v for name, v in file.variables.items() if name not in (GRID_MAPPING, *v.dimensions)]
    frame = "map" if imagery.georeference else "local"
    coordinates = []
    for number, name in enumerate(("east", "north")):
        _variable(file, name, place[..., number], dimensions, "m", f"{frame} {name}ing")
        coordinates.append(name)
    if imagery.georeference:
        file.variables["east"].standard_name = "projection_x_coordinate"
        file.variables["north"].standard_name = "projection_y_coordinate"
        crs = CRS.from_wkt(imagery.georeference.crs_wkt).to_2d()
        lonlat = Transformer.from_crs(crs, 4326, always_xy=True).transform(place[..., 0], place[..., 1])
        for name, degrees, unit in zip(("longitude", "latitude"), lonlat, ("east", "north"), strict=True):
            _variable(file, name, np.asarray(degrees), dimensions, f"degrees_{unit}", f"{name}, WGS 84")
            file.variables[name].standard_name = name
            coordinates.append(name)
    for variable in measured:
        variable.coordinates = " ".join(coordinates)
        if imagery.georeference:
            variable.grid_mapping = GRID_MAPPING


def _origin_m(imagery: Imagery) -> tuple[float, float, float]:
    return imagery.georeference.origin_m if imagery.georeference else (0.0, 0.0, 0.0)


def _axis(file: netcdf_file, name: str, values: np.ndarray, meaning: str) -> None:
    file.createDimension(name, len(values))
    _variable(file, name, values, (name,), "m", meaning)


def _variable(
    file: netcdf_file, name: str, values: np.ndarray, dimensions: tuple[str, ...], units: str, meaning: str
) -> None:
    variable = file.createVariable(name, values.dtype, dimensions)
    variable[:] = values
    variable.units, variable.long_name = units, meaning
