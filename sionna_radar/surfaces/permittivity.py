"""Complex relative permittivity of natural and built surfaces, with the published range of each formula.

Convention: eps = eps' - j eps'' for fields that vary as exp(+j w t); a lossy medium has a negative imaginary
part. Frequencies are in hertz, temperatures in degrees Celsius, densities in g/cm3, as in the sources.

Sources of the numbers (all read while this file was written):

* ITU-R P.527-6, "Electrical characteristics of the surface of the Earth". The Recommendation's own text could
  not be read; its equations were taken, with their numbers, from The MathWorks' `earthSurfacePermittivity.m`
  (2019-2024), which names the equation beside each line. Water and soil were checked coefficient by
  coefficient against a second, independent transcription of P.527-4 (github elvd/rf_sewer_pipes,
  itur_p527.py); ice against SMRT's `ice_permittivity_maetzler06`; vegetation against Code 4.8 of Ulaby and
  Long, "Microwave Radar and Radiometric Remote Sensing" (2014).
* The measured bands: Hallikainen and others, "Microwave Dielectric Behavior of Wet Soil, Part I" (abstract:
  1.4 to 18 GHz) and "Microwave Dielectric Spectrum of Vegetation, Part I" (abstract: 0.2 to 20 GHz).
* ITU-R P.2040-3, Table 3, as shipped in sionna-rt 2.2.0 (`sionna/rt/radio_materials/itu.py`).
* Kurz, Stuelzebach, Pfeiffer, van Driesten and Biebl, "Road Surface Characteristics for the Automotive 77 GHz
  Band", Adv. Radio Sci. 19 (2021) 165-172: abstract read there, the numbers in the authors' own data files
  (github LudwigFriedmann/OpenMATERIAL, `materials/data/*_permittivity.gltf`: 76-81 GHz, 280 K, 45 deg).

`SOURCES` gives for each function the band its formula is published for and the band in which the
measurements behind it were made, where known. At 77 GHz soil and vegetation are inside the first but
not the second: the formula is ITU's, but not confirmed by measurement.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

from scipy.constants import epsilon_0

from sionna_radar.weather import permittivity

_GHZ = 1e9


@dataclass(frozen=True, kw_only=True)
class Citation:
    """The source of a permittivity and its range (frequencies in hertz)."""

    document: str
    published_hz: tuple[float, float]
    measured_hz: tuple[float, float] | None
    note: str


SOURCES: Mapping[str, Citation] = MappingProxyType(
    {
        "water": Citation(
            document="ITU-R P.527-6 section 5.1.1, eqs. 5-13 (double Debye)",
            published_hz=(0.0, 1000e9),
            measured_hz=None,
            note="inside its range at 77 GHz; within 2 % of tabulated 94 GHz indices at 10 and 20 deg C",
        ),
        "ice": Citation(
            document="ITU-R P.527-6 section 5.1.3.1, eqs. 28-34 (Maetzler 2006)",
            published_hz=(0.0, 1000e9),
            measured_hz=None,
            note="inside its range at 77 GHz",
        ),
        "dry_snow": Citation(
            document="ITU-R P.527-6 section 5.1.4.1, eqs. 51-53",
            published_hz=(0.0, 100e9),
            measured_hz=None,
            note="inside its range at 77 GHz; absorption only, scattering by grains is not in a permittivity",
        ),
        "wet_snow": Citation(
            document="ITU-R P.527-6 section 5.1.4.2, eqs. 54-55 (water spheres in dry snow)",
            published_hz=(0.0, 100e9),
            measured_hz=None,
            note=(
                "inside its range at 77 GHz, but its loss is a fraction of that measured at 3 to 37 GHz "
                "(Ulaby and Long 2014, Figs. 4-22 and 4-23)"
            ),
        ),
        "soil": Citation(
            document="ITU-R P.527-6 section 5.2, eqs. 57-70 (the form of Dobson and others 1985)",
            published_hz=(0.0, 1000e9),
            measured_hz=(1.4e9, 18e9),
            note=(
                "published to 1000 GHz, measured to 18 GHz: an extrapolation at 77 GHz; unfrozen soil only. "
                "At 18 GHz a loam of 10 to 30 % moisture is within 27 % (real part) and 15 % (loss) of the "
                "fits of Hallikainen and others 1985"
            ),
        ),
        "vegetation": Citation(
            document="ITU-R P.527-6 section 5.3.1, eqs. 72-77 (the form of Ulaby and El-Rayes)",
            published_hz=(0.0, 1000e9),
            measured_hz=(0.2e9, 20e9),
            note="published to 1000 GHz, measured to 20 GHz: an extrapolation at 77 GHz; leaf, not canopy",
        ),
        "leaf": Citation(
            document='Maetzler 1994, "Microwave (1-100 GHz) dielectric model of leaves", IEEE TGRS 32 (1994), 947',
            published_hz=(1e9, 100e9),
            measured_hz=(1e9, 94e9),
            note="fresh leaves: a mass fraction of water of 0.5 to 0.9",
        ),
        "asphalt": Citation(
            document="Kurz and others 2021 (doi 10.5194/ars-19-165-2021), data in OpenMATERIAL",
            published_hz=(76e9, 81e9),
            measured_hz=(76e9, 81e9),
            note=(
                "measured at 77 GHz, from the power reflected at 45 deg by Fresnel's equations: an effective real "
                "permittivity that includes the loss and the texture of the road; P.2040-3 has 4.83 - j1.09 "
                "extrapolated from 40 GHz"
            ),
        ),
    }
)


@dataclass(frozen=True)
class _BuildingRow:
    """One row of ITU-R P.2040-3 Table 3: eps' = a f^b, conductivity = c f^d (S/m), f in GHz."""

    lowest_ghz: float
    highest_ghz: float
    a: float
    b: float
    c: float
    d: float


# ITU-R P.2040-3 Table 3. Only the rows that start below 100 GHz: this is a 77 GHz simulator.
_BUILDING: Mapping[str, _BuildingRow] = MappingProxyType(
    {
        "concrete": _BuildingRow(1.0, 100.0, 5.24, 0.0, 0.0462, 0.7822),
        "brick": _BuildingRow(1.0, 40.0, 3.91, 0.0, 0.0238, 0.16),
        "plasterboard": _BuildingRow(1.0, 100.0, 2.73, 0.0, 0.0085, 0.9395),
        "wood": _BuildingRow(0.001, 100.0, 1.99, 0.0, 0.0047, 1.0718),
        "glass": _BuildingRow(0.1, 100.0, 6.31, 0.0, 0.0036, 1.3394),
        "ceiling_board": _BuildingRow(1.0, 100.0, 1.48, 0.0, 0.0011, 1.0750),
        "chipboard": _BuildingRow(1.0, 100.0, 2.58, 0.0, 0.0217, 0.7800),
        "plywood": _BuildingRow(1.0, 40.0, 2.71, 0.0, 0.33, 0.0),
        "marble": _BuildingRow(1.0, 60.0, 7.074, 0.0, 0.0055, 0.9262),
        "floorboard": _BuildingRow(50.0, 100.0, 3.66, 0.0, 0.0044, 1.3515),
        "asphalt_concrete": _BuildingRow(1.0, 40.0, 4.83, 0.0, 0.0108, 1.3969),
        "metal": _BuildingRow(1.0, 100.0, 1.0, 0.0, 1e7, 0.0),
    }
)

# Real permittivity of dry road surfaces at 76 to 81 GHz: asphalt concrete and stone mastic asphalt, by grain in mm.
_ASPHALT: Mapping[str, float] = MappingProxyType({"AC11DS": 8.6, "SMA8S": 10.4, "SMA11S": 8.3})


def _require(field: str, value: float, lowest: float, highest: float, remedy: str) -> None:
    """Raise ValueError unless lowest <= value <= highest (which also rejects NaN)."""
    if not lowest <= value <= highest:
        raise ValueError(f"{field} = {value:g} is outside {lowest:g} to {highest:g}; {remedy}")


def _ghz_inside(frequency_hz: float, name: str) -> float:
    """Return the frequency in GHz; ValueError outside the published band of the formula."""
    source = SOURCES[name]
    remedy = f"{source.document} is not valid there: give a measured complex permittivity instead"
    lowest, highest = source.published_hz
    if frequency_hz <= lowest:
        raise ValueError(f"frequency_hz = {frequency_hz:g} must be positive; give the carrier in hertz")
    _require("frequency_hz", frequency_hz, lowest, highest, remedy)
    return frequency_hz / _GHZ


def water_permittivity(frequency_hz: float, *, temperature_c: float) -> complex:
    """Return the permittivity of pure liquid water, -4 to 40 deg C, up to 1000 GHz (P.527-6 eqs. 5-13)."""
    _ghz_inside(frequency_hz, "water")
    _require("temperature_c", temperature_c, -4.0, 40.0, "this is the range of P.527 for liquid water")
    return _water(frequency_hz, temperature_c)


def _water(frequency_hz: float, temperature_c: float) -> complex:
    return permittivity.surface_water_permittivity(frequency_hz, temperature_c + permittivity.MELTING_K).conjugate()


def ice_permittivity(frequency_hz: float, *, temperature_c: float) -> complex:
    """Return the permittivity of pure ice, -60 to 0 deg C, up to 1000 GHz (P.527-6 eqs. 28-34)."""
    _ghz_inside(frequency_hz, "ice")
    _require("temperature_c", temperature_c, -60.0, 0.0, "ice exists at and below 0; use water above")
    return permittivity.ice_permittivity(frequency_hz, temperature_c + permittivity.MELTING_K).conjugate()


def dry_snow_permittivity(frequency_hz: float, *, temperature_c: float, density_g_cm3: float) -> complex:
    """Return the permittivity of dry snow, -60 to 0 deg C, up to 100 GHz (P.527-6 eqs. 51-53).

    The real part depends on density only; it is taken up to the density of ice, 0.916 g/cm3.
    """
    _ghz_inside(frequency_hz, "dry_snow")
    ice_density = 0.916  # g/cm3, P.527-6 section 5.1.4.1
    _require("density_g_cm3", density_g_cm3, 0.0, ice_density, "snow cannot be denser than ice")
    pure = ice_permittivity(frequency_hz, temperature_c=temperature_c)
    ice_loss = -pure.imag
    real = 1.0 + 1.9 * density_g_cm3 if density_g_cm3 <= 0.5 else 0.51 + 2.88 * density_g_cm3
    filling = density_g_cm3 / ice_density
    loss = (
        3.0 * filling * ice_loss * real**2 * (2.0 * real + 1.0)
        / ((pure.real + 2.0 * real) * (pure.real + 2.0 * real**2))
    )  # fmt: skip
    return complex(real, -loss)


def wet_snow_permittivity(
    frequency_hz: float, *, temperature_c: float, dry_density_g_cm3: float, liquid_fraction: float
) -> complex:
    """Return the permittivity of wet snow, up to 100 GHz (P.527-6 eqs. 54-55).

    `liquid_fraction` is the volume of liquid water per volume of snow (0 to 1). The temperature must lie
    where both constituents are defined, -4 to 0 deg C; melting snow is at 0.

    The mixture takes the water as spheres. Wet snow measured from 3 to 37 GHz has two to four times the loss
    (Ulaby and Long 2014, Figs. 4-22 and 4-23: 1.43 - j0.24 at 37 GHz, 6 % water, dry density 0.25 g/cm3,
    instead of 1.75 - j0.06 here), so give a measured permittivity if the loss matters.
    """
    _ghz_inside(frequency_hz, "wet_snow")
    _require("temperature_c", temperature_c, -4.0, 0.0, "wet snow is at its melting point: use 0")
    _require("liquid_fraction", liquid_fraction, 0.0, 1.0, "give a volume fraction, not a percentage")
    dry = dry_snow_permittivity(frequency_hz, temperature_c=temperature_c, density_g_cm3=dry_density_g_cm3)
    water = _water(frequency_hz, temperature_c)
    # Self-consistent mixture of spheres: 2 x^2 + b x - water dry = 0. The root that tends to `dry` without
    # water is the one with the positive sign of the (principal) square root.
    b = water - 2.0 * dry - 3.0 * liquid_fraction * (water - dry)
    return (-b + (b * b + 8.0 * water * dry) ** 0.5) / 4.0


def soil_permittivity(
    frequency_hz: float,
    *,
    temperature_c: float,
    sand_percent: float,
    clay_percent: float,
    water_fraction: float,
    specific_gravity: float,
    bulk_density_g_cm3: float | None = None,
) -> complex:
    """Return the permittivity of unfrozen moist soil, 0 to 40 deg C, up to 1000 GHz (P.527-6 eqs. 57-70).

    `water_fraction` is the volume of water per volume of soil; what is neither sand nor clay is silt;
    `specific_gravity` is that of the dry grains. Without a bulk density P.527 estimates it from texture.
    The formula is published to 1000 GHz; the measurements behind it stop at 18 GHz (see `SOURCES`).
    """
    f = _ghz_inside(frequency_hz, "soil")
    _require("temperature_c", temperature_c, 0.0, 40.0, "frozen soil is not covered: give a measured value")
    _require("sand_percent", sand_percent, 0.0, 100.0, "give a percentage")
    _require("clay_percent", clay_percent, 0.0, 100.0 - sand_percent, "sand and clay exceed 100 together")
    _require("specific_gravity", specific_gravity, 1.0, 10.0, "give the density of the grains relative to water")
    bulk = bulk_density_g_cm3
    if bulk is None:
        bulk = soil_bulk_density_g_cm3(sand_percent, clay_percent)
    _require("bulk_density_g_cm3", bulk, 0.0, specific_gravity, "soil cannot be denser than its grains")
    porosity = 1.0 - bulk / specific_gravity
    _require("water_fraction", water_fraction, 0.0, porosity, "water cannot exceed the pore volume")
    water = _soil_water(f, temperature_c, sand_percent, clay_percent, water_fraction, porosity, bulk)
    # P.527-6 eqs. 58-64: the mixture is additive in this power of the permittivity.
    exponent = 0.65
    real_power = 1.2748 - 0.00519 * sand_percent - 0.00152 * clay_percent
    loss_power = 1.33797 - 0.00603 * sand_percent - 0.00166 * clay_percent
    grains = (1.01 + 0.44 * specific_gravity) ** 2 - 0.062
    real = (
        1.0
        + bulk / specific_gravity * (grains**exponent - 1.0)
        + water_fraction**real_power * water.real**exponent
        - water_fraction
    ) ** (1.0 / exponent)
    loss = (water_fraction**loss_power * (-water.imag) ** exponent) ** (1.0 / exponent)
    return complex(real, -loss)


def _soil_water(
    f_ghz: float,
    temperature_c: float,
    sand_percent: float,
    clay_percent: float,
    water_fraction: float,
    porosity: float,
    bulk_density_g_cm3: float,
) -> complex:
    """Return the permittivity of the free water in soil, with its conductivity (P.527-6 eqs. 65-70)."""
    pure = _water(f_ghz * _GHZ, temperature_c)
    if water_fraction < 1e-12:
        return pure  # multiplied by almost zero afterwards; the conductivity term would overflow
    bulk = bulk_density_g_cm3
    low_conductivity = 0.0467 + 0.2204 * bulk - 0.004111 * sand_percent - 0.006614 * clay_percent
    high_conductivity = -1.645 + 1.939 * bulk - 0.0225622 * sand_percent + 0.01594 * clay_percent
    ratio = f_ghz / 1.35
    step = (low_conductivity - high_conductivity) / (1.0 + ratio**2)
    scale = 18.0 * porosity / (f_ghz * water_fraction)
    # At a few GHz the fitted conductivity of dry sandy soil becomes negative; a passive medium has no gain.
    real = max(pure.real + scale * ratio * step, 1.0)
    loss = max(-pure.imag + scale * (high_conductivity + step), 0.0)
    return complex(real, -loss)


def soil_bulk_density_g_cm3(sand_percent: float, clay_percent: float) -> float:
    """Return P.527-6's estimate of bulk density from texture (eq. 57).

    A constituent below one percent is omitted and the others rescaled to a hundred, as P.527-6 specifies.
    """
    percentages = (sand_percent, clay_percent, 100.0 - sand_percent - clay_percent)
    significant = [percentage if percentage >= 1.0 else 0.0 for percentage in percentages]
    total = sum(significant)
    weights = (0.078886, 0.038753, 0.032732)
    return 1.07256 + sum(
        weight * math.log(100.0 * percentage / total)
        for weight, percentage in zip(weights, significant, strict=True)
        if percentage > 0.0
    )


def vegetation_permittivity(frequency_hz: float, *, temperature_c: float, water_fraction: float) -> complex:
    """Return the permittivity of unfrozen leaves and stalks, 0 to 40 deg C (P.527-6 eqs. 72-77).

    `water_fraction` is the mass of water per mass of moist vegetation, 0 to 0.7. It is the permittivity of
    the material itself, not of a canopy with air in it. The formula is published to 1000 GHz; the
    measurements behind it stop at 20 GHz (see `SOURCES`).
    """
    f = _ghz_inside(frequency_hz, "vegetation")
    _require("temperature_c", temperature_c, 0.0, 40.0, "frozen vegetation is not covered")
    _require("water_fraction", water_fraction, 0.0, 0.7, "give a mass fraction; the fit ends at 0.7")
    moisture = water_fraction
    dry = 1.7 - 0.74 * moisture + 6.16 * moisture**2  # eq. 75
    # The fitted share of free water is slightly negative below 14 % moisture, and set to zero.
    free = max(moisture * (0.55 * moisture - 0.076), 0.0)  # eq. 76
    bound = 4.64 * moisture**2 / (1.0 + 7.36 * moisture**2)  # eq. 77
    relaxation = permittivity.surface_water_relaxation_ghz(temperature_c + permittivity.MELTING_K)
    root = math.sqrt(f / (0.02 * relaxation))
    denominator = 1.0 + 2.0 * root + f / (0.01 * relaxation)
    water = _water(frequency_hz, temperature_c)
    real = dry + free * water.real + bound * (2.9 + 55.0 * (1.0 + root) / denominator)
    loss = free * (-water.imag + 22.86 / f) + bound * 55.0 * root / denominator
    return complex(real, -loss)


# Saline water in leaves: a salinity of 1 % at 20 deg C, S/m (Ulaby and El-Rayes 1987: 0.17 S - 0.0013 S^2, S = 10).
LEAF_TEMPERATURE_C, LEAF_CONDUCTIVITY = 20.0, 1.57
# Mass fraction of water above which a leaf is fresh: Maetzler's data end there.
FRESH_LEAF = 0.5


def leaf_permittivity(frequency_hz: float, *, water_content: float) -> complex:
    """Return the permittivity of a leaf at 20 deg C, 1 to 100 GHz (Maetzler 1994).

    `water_content` is the mass of water per mass of moist leaf, 0 to 0.9. Below 0.5, where Maetzler's formula ends, it
    is `vegetation_permittivity`; read in a transcription of section 5.7.4 of Maetzler 2006.
    """
    _ghz_inside(frequency_hz, "leaf")
    _require("water_content", water_content, 0.0, 0.9, "give the mass of water over that of the fresh leaf")
    if water_content < FRESH_LEAF:
        return vegetation_permittivity(frequency_hz, temperature_c=LEAF_TEMPERATURE_C, water_fraction=water_content)
    dry = 1.0 - water_content
    water = _water(frequency_hz, LEAF_TEMPERATURE_C)
    saline = water - 1j * LEAF_CONDUCTIVITY / (2 * math.pi * frequency_hz * epsilon_0)
    return 0.51 + 3.84 * dry + 0.522 * (1.0 - 1.32 * dry) * saline


def asphalt_permittivity(frequency_hz: float, *, mix: str) -> complex:
    """Return the effective permittivity of a dry asphalt road, 76 to 81 GHz (Kurz and others 2021).

    `mix` is "AC11DS" (asphalt concrete), "SMA8S" or "SMA11S" (stone mastic asphalt), the number being the
    largest grain in millimetres. It was derived from the power reflected at 45 deg, so it is real: loss and
    texture are included, not separate.
    """
    source = SOURCES["asphalt"]
    _require("frequency_hz", frequency_hz, *source.published_hz, "give a measured complex permittivity instead")
    return complex(_ASPHALT[mix])


def building_permittivity(material: str, frequency_hz: float) -> complex:
    """Return the permittivity of a building material of ITU-R P.2040-3 Table 3, inside its own band.

    At 77 GHz: concrete, plasterboard, wood, glass, ceiling_board, chipboard, floorboard and metal. Brick,
    plywood and asphalt_concrete end at 40 GHz and marble at 60 GHz, and are rejected above.
    """
    row, f = _BUILDING[material], frequency_hz / _GHZ
    if not row.lowest_ghz <= f <= row.highest_ghz:
        raise ValueError(
            f"frequency_hz = {frequency_hz:g} is outside {row.lowest_ghz:g} to {row.highest_ghz:g} GHz, "
            f"where ITU-R P.2040-3 defines {material}; give a measured complex permittivity instead"
        )
    conductivity = row.c * f**row.d
    return complex(row.a * f**row.b, -conductivity / (2.0 * math.pi * frequency_hz * epsilon_0))
