"""Backscatter models: sigma0 against local incidence by analytic laws, tables and measured levels.

Measured backscatter comes as the handbook's fitted form, or as tables of sigma0 against incidence. The fitted form is
that of Ulaby and Dobson, "Handbook of Radar Scattering Statistics for Terrain" (Artech House, 1989). Its W-band
parameters were not found in any available source (the only parameters found were a public transcription for the L, S
and C bands, one set of which its author had refitted), so none is shipped: the form takes the user's parameters, from
the handbook or from a fit to measurements near the carrier. MathWorks documents its implementation of the same model
for 1 to 18 GHz only: do not use those at 77 GHz.
"""

import csv
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float
from scipy.interpolate import PchipInterpolator

from sionna_radar.foundation.errors import InputFileError
from sionna_radar.foundation.input_file import read_numbers, read_text, shown


@runtime_checkable
class Backscatter(Protocol):
    """A model of the monostatic backscatter of an extended surface.

    Any object with this method is a model.
    """

    def sigma0(self, incidence_rad: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """Return the radar cross-section per unit of surface area (a ratio) at incidence angles."""


@runtime_checkable
class HasScatteredFraction(Protocol):
    """A model with a scattering pattern in all directions, not only backward."""

    def scattered_fraction(self, incidence_rad: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """Return scattered over incident power of the co-polar field at incidence angles."""


@dataclass(frozen=True)
class ConstantGammaBackscatter:
    """sigma0 = gamma cos(incidence) (Rouveure et al. 2017, eq. 7)."""

    gamma: float

    def sigma0(self, incidence_rad: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """Return the radar cross-section per unit of surface area."""
        return self.gamma * np.cos(incidence_rad)


@dataclass(frozen=True)
class LambertianBackscatter:
    """sigma0 = sigma0(nadir) cos^2(incidence): Lambert's law in the backscatter direction."""

    nadir_sigma0: float

    def sigma0(self, incidence_rad: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """Return the radar cross-section per unit of surface area."""
        return self.nadir_sigma0 * np.cos(incidence_rad) ** 2

    def scattered_fraction(self, incidence_rad: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """Return scattered over incident power: the albedo, 1 (and a nadir sigma0 of 4, 6 dB) at most in nature.

        Toward every direction sigma0 is 4 albedo cos(in) cos(out); over 4 pi cos(in), its integral is the albedo.
        """
        return np.full(len(incidence_rad), self.nadir_sigma0 / 4)


_COLUMNS = {"incidence_deg": None, "sigma0_db": None}


@dataclass(frozen=True, kw_only=True)
class UlabyDobsonBackscatter:
    """The handbook's form, sigma0_dB = p1 + p2 exp(-p3 t) + p4 cos(p5 t + p6), t the incidence in radians.

    All parameters come from the user: p1, p2 and p4 in dB, p3 and p5 per radian, p6 in radians.
    `min_incidence_rad` and `max_incidence_rad` bound the fit; beyond them the value at the nearer bound is
    used, because the form does not extrapolate. `source`
    states the origin of the parameters: document, band and polarization.
    """

    p1: float
    p2: float
    p3: float
    p4: float
    p5: float
    p6: float
    min_incidence_rad: float
    max_incidence_rad: float
    source: str

    def sigma0(self, incidence_rad: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """Return the radar cross-section per unit of surface area; zero at and beyond 90 deg."""
        angle = np.clip(np.abs(incidence_rad), self.min_incidence_rad, self.max_incidence_rad)
        level_db = self.p1 + self.p2 * np.exp(-self.p3 * angle) + self.p4 * np.cos(self.p5 * angle + self.p6)
        return np.where(_is_lit(incidence_rad), 10.0 ** (level_db / 10.0), 0.0)


@dataclass(frozen=True, kw_only=True)
class TableBackscatter:
    """sigma0 tabulated against incidence, interpolated in dB without overshoot (monotone cubic, PCHIP).

    Outside the table the value at its nearer end is used, since terrain has facets at every angle. At and beyond
    90 deg the surface faces away and sigma0 is zero.
    """

    incidence_rad: tuple[float, ...]
    sigma0_db: tuple[float, ...]

    def __post_init__(self) -> None:
        if len(self.incidence_rad) != len(self.sigma0_db):
            raise ValueError(
                f"incidence_rad has {len(self.incidence_rad)} values and sigma0_db {len(self.sigma0_db)}; "
                "they must pair up"
            )
        if len(self.incidence_rad) < 2:
            raise ValueError(f"incidence_rad has {len(self.incidence_rad)} value(s); a table needs two rows or more")
        angles = np.array(self.incidence_rad)
        if not np.all(np.diff(angles) > 0) or angles[0] < 0.0 or angles[-1] > math.pi / 2:
            raise ValueError("incidence_rad must increase strictly, within 0 to pi/2")
        if not np.all(np.isfinite(self.sigma0_db)):
            raise ValueError("sigma0_db must be finite at every row")

    @classmethod
    def from_csv(cls, path: Path) -> "TableBackscatter":
        """Read a table with the columns incidence_deg and sigma0_db; lines starting with # are comments.

        Raises InputFileError, naming the line, for a file that is missing or does not contain such a table.
        """
        remedy = f"give a CSV file with the columns {' and '.join(_COLUMNS)}"
        lines, (angles_deg, levels_db) = read_numbers(path, "table of sigma0", _COLUMNS, remedy)
        for number, angle_deg, before_deg in zip(lines, angles_deg, (-math.inf, *angles_deg), strict=False):
            if not before_deg < angle_deg or not 0.0 <= angle_deg <= 90.0:
                message = f"{path}: line {number}: incidence_deg = {angle_deg:g} must increase within 0 to 90"
                raise InputFileError(message)
        if len(lines) < 2:
            raise InputFileError(f"{path}: holds 1 row; a table needs two or more")
        return cls(incidence_rad=tuple(np.radians(angles_deg).tolist()), sigma0_db=levels_db)

    def sigma0(self, incidence_rad: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """Return the radar cross-section per unit of surface area."""
        angle = np.clip(np.abs(incidence_rad), self.incidence_rad[0], self.incidence_rad[-1])
        # The interpolator divides by level differences: round them to a billionth of a dB.
        levels_db = np.round(self.sigma0_db, 9)
        level_db = PchipInterpolator(self.incidence_rad, levels_db)(angle)
        return np.where(_is_lit(incidence_rad), 10.0 ** (level_db / 10.0), 0.0)


def _is_lit(incidence_rad: Float[np.ndarray, " n"]) -> Bool[np.ndarray, " n"]:
    return np.abs(incidence_rad) < math.pi / 2


LEVEL_COLUMNS = ("cover", "incidence_deg", "polarization", "sigma0_db")


@dataclass(frozen=True, kw_only=True)
class Levels:
    """Measured levels, one row each.

    cover: material of the ground. polarization_rad: of the linear wave, from the plane of incidence: 0 VV, pi/2 HH.
    sigma0: a ratio. looks: independent ones averaged; infinite for a level without speckle.
    cross: received across the wave that was sent: 0 is HV.
    """

    cover: tuple[str, ...]
    incidence_rad: Float[np.ndarray, " row"]
    polarization_rad: Float[np.ndarray, " row"]
    sigma0: Float[np.ndarray, " row"]
    looks: Float[np.ndarray, " row"]
    cross: Bool[np.ndarray, " row"]

    def __len__(self) -> int:
        return len(self.cover)

    def of(self, cover: str) -> Bool[np.ndarray, " row"]:
        """Return a mask of the rows of a cover."""
        return np.array([name == cover for name in self.cover], dtype=bool)

    @classmethod
    def from_csv(cls, path: Path) -> "Levels":
        """Read a table of cover, incidence_deg, polarization, sigma0_db and perhaps looks.

        The polarization is VV, HH, HV (or VH, which is the same), or an angle from the plane of incidence in degrees,
        with an x behind it if it is received across; lines starting with # are comments. Raises InputFileError, naming
        the line, for a file that is missing or does not contain such a table.
        """
        header_text = f"{','.join(LEVEL_COLUMNS)}[,looks]"
        text = read_text(path, "--levels", f"give a CSV file with the columns {header_text}")
        lines = [
            (number, line.strip())
            for number, line in enumerate(text.splitlines(), start=1)
            if line.strip() and not line.lstrip().startswith("#")
        ]
        header = tuple(name.strip() for name in lines[0][1].split(",")) if lines else ()
        if header not in (LEVEL_COLUMNS, (*LEVEL_COLUMNS, "looks")):
            raise InputFileError(f"{shown(path)}: begins with {shown(','.join(header))}; the header is {header_text}")
        rows = [_parse_level(path, number, line, len(header)) for number, line in lines[1:]]
        if not rows:
            raise InputFileError(f"{shown(path)}: has no rows; give one for each cover, incidence and polarization")
        cover, *columns = zip(*rows, strict=True)
        incidence_rad, polarization_rad, sigma0, looks, cross = map(np.array, columns)
        return cls(
            cover=tuple(map(str, cover)),
            incidence_rad=incidence_rad,
            polarization_rad=polarization_rad,
            sigma0=sigma0,
            looks=looks,
            cross=cross,
        )

    def to_csv(self) -> str:
        """Return the table as `from_csv` reads it."""
        lines = [",".join((*LEVEL_COLUMNS, "looks"))]
        for row in range(len(self)):
            angles = np.rad2deg([self.incidence_rad[row], self.polarization_rad[row]])
            level_db = 10 * math.log10(self.sigma0[row])
            polarization = f"{angles[1]:.6g}{'x' * int(self.cross[row])}"
            lines.append(f"{self.cover[row]},{angles[0]:.6g},{polarization},{level_db:.9g},{self.looks[row]:g}")
        return "\n".join(lines) + "\n"


def _parse_level(path: Path, number: int, line: str, columns: int) -> tuple[str, float, float, float, float, bool]:
    """Return cover, incidence (rad), polarization (rad), sigma0, looks and whether it is cross-polar of a line."""
    try:
        cover, *cells = (cell.strip() for cell in next(csv.reader([line], strict=True)))
        polarization = {"VV": "0", "HH": "90", "HV": "0x", "VH": "0x"}.get(cells[1].upper(), cells[1])
        cross = polarization.endswith("x")
        values = [float(cell) for cell in (cells[0], polarization.removesuffix("x"), *cells[2:])]
        if len(values) + 1 != columns:
            raise ValueError
    except (ValueError, IndexError, csv.Error) as error:
        raise InputFileError(
            f"{shown(path)}: line {number} reads {shown(line)}; give a cover, an incidence in degrees, VV, HH, HV or "
            "an angle in degrees, sigma0 in dB, and looks if the header has them"
        ) from error
    incidence_deg, polarization_deg, level_db, looks = (*values, math.inf)[:4]
    for name, value, valid, wanted in (
        ("incidence_deg", incidence_deg, 0 <= incidence_deg < 90, "give 0 or more, below 90"),
        ("polarization", polarization_deg, 0 <= polarization_deg <= 180, "give VV, HH, HV, or 0 to 180 deg"),
        ("sigma0_db", level_db, abs(level_db) < 200, "give a level in dB, or leave the row out"),
        ("looks", looks, looks > 0, "give a positive number"),
    ):
        if not valid:
            raise InputFileError(f"{shown(path)}: line {number}: {name} = {value:g} is not possible; {wanted}")
    return cover, math.radians(incidence_deg), math.radians(polarization_deg), 10 ** (level_db / 10), looks, cross
