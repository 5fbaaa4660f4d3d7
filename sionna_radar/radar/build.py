"""Builder of the radar of a scenario: antenna, sweeps, second receivers and MIMO array."""

import logging
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np
from jaxtyping import Complex, Float

from sionna_radar.foundation.build_cache import BuildCache
from sionna_radar.foundation.decibels import from_db
from sionna_radar.foundation.errors import ScenarioError
from sionna_radar.foundation.randomness import Stream, pulse_generator
from sionna_radar.radar.antenna import Antenna, Pattern, Squint, antenna_of, reach_of_power, two_way_spread
from sionna_radar.radar.array_antenna import LARGEST_WAVELENGTHS, line_taper, read_elements, taylor_cut
from sionna_radar.radar.array_pattern import ArrayPattern, ElementPattern, array_factor, steered
from sionna_radar.radar.chirp import Chirp, used
from sionna_radar.radar.mimo_array import UNAMBIGUOUS, MimoArray, code_of, difference_pattern, receiver_mixing
from sionna_radar.scenario.bases import AntennaParameters
from sionna_radar.scenario.loading import content_key
from sionna_radar.scenario.parts import ANTENNAS
from sionna_radar.scenario.radar import AntennaTable, ArrayAntennaTable, PatternAntennaTable, RadarTable
from sionna_radar.scenario.readers import ANTENNA_FREQUENCY, ANTENNA_PATTERN
from sionna_radar.scenario.receiver import ArrayTable, SecondReceiverTable
from sionna_radar.scenario.registry import PACKAGE, Builder, registers

logger = logging.getLogger("sionna_radar")


@registers(ANTENNAS, "[radar.antenna]")
def register_antenna(name: str, parameters: type[AntennaParameters]) -> Callable[[Builder], Builder]:
    """Register an antenna, for `radar.antenna.kind` in a scenario.

    It decorates a function that builds an `Antenna`; it is called with the parameters.

    Examples
    --------
    >>> import numpy as np
    >>> from sionna_radar.radar import Antenna, Cut
    >>> from sionna_radar.scenario import AntennaParameters
    >>> class Horn(AntennaParameters):
    ...     exponent: float = 200.0
    >>> @register_antenna("horn", Horn)
    ... def horn(parameters):
    ...     cut = Cut(np.sqrt(1 - np.linspace(-1, 1, 4001) ** 2) ** (parameters.exponent / 2))
    ...     return Antenna(cut, cut, parameters.polarization, parameters.receive_polarization)
    >>> antenna = {"kind": "horn", "exponent": 500.0}
    >>> prepared = prepare(load_scenario("hills", {"radar.antenna": antenna, "platform.length_m": 10.0}))
    >>> bool(np.rad2deg(prepared.instrument.antenna.beamwidths_rad[0]) > 5)
    True
    """
    return ANTENNAS.register(name, parameters)


def build_antenna(table: AntennaParameters, cache: BuildCache | None = None) -> Antenna:
    """Return the antenna of a scenario.

    Parameters
    ----------
    table:
        Table `[radar.antenna]`.
    cache:
        Of an earlier survey, for the same antenna in this one.

    Returns
    -------
    The antenna.

    Raises
    ------
    ScenarioError, InputFileError
        The antenna cannot be built from its table or its pattern file.
    """
    key = content_key({"antenna": table}) if ANTENNAS.entry(table.kind).origin == PACKAGE else None
    return (cache or BuildCache()).once("antenna", key, lambda: ANTENNAS.build(table.kind, Antenna, table))


# Share of a pattern's frequency by which the carrier may differ; the beamwidth differs by as much.
SAME_FREQUENCY = 0.05


def warn_of_frequency(table: AntennaParameters, carrier_hz: float) -> None:
    """Warn of pattern files made at another frequency than the carrier."""
    for field in ("pattern", "receive_pattern", "element_pattern"):
        path = getattr(table, field, None)
        if not isinstance(path, Path):
            continue
        stated = ANTENNA_FREQUENCY(path)
        if stated is None or stated[0] * (1 - SAME_FREQUENCY) <= carrier_hz <= stated[1] * (1 + SAME_FREQUENCY):
            continue
        band = " to ".join(f"{frequency / 1e9:.4g}" for frequency in dict.fromkeys(stated))
        logger.warning(
            "radar.antenna.%s = %s: states %s GHz, and radar.carrier_hz is %.4g GHz, where an antenna has another "
            "beam; give its pattern at the carrier",
            field,
            path.name,
            band,
            carrier_hz / 1e9,
        )


# Widest turn over a sweep, in beamwidths: amplitudes over it are polynomials.
WIDEST_SQUINT = 10.0


def squinting(
    table: AntennaParameters, antenna: Antenna, sweeps: tuple[Chirp, ...]
) -> tuple[Antenna, tuple[Chirp, ...]]:
    """Return the mean antenna over a sweep that squints, and the sweeps with the turn of its beam; else both as given.

    Raises ScenarioError for an antenna without two cuts, and for a turn of more than `WIDEST_SQUINT`.
    """
    if table.squint_deg_per_ghz == 0:
        return antenna, sweeps
    key, rad_per_hz = "radar.antenna.squint_deg_per_ghz", float(np.deg2rad(table.squint_deg_per_ghz)) * 1e-9
    if not antenna.separable:
        message = f"{table.squint_deg_per_ghz:g} applies to antennas of two cuts only, such as kind = 'taylor'; set 0"
        raise ScenarioError.of(key, message)
    if (widths := abs(rad_per_hz) * sweeps[0].bandwidth_hz / antenna.beamwidths_rad[0]) > WIDEST_SQUINT:
        message = (
            f"{table.squint_deg_per_ghz:g} turns the beam by {widths:.3g} of its widths, more than {WIDEST_SQUINT:g}"
        )
        raise ScenarioError.of(key, f"{message}; lower it, or radar.bandwidth_hz")
    squint = Squint.of(antenna, rad_per_hz, sweeps[0].bandwidth_hz)
    return squint.mean, tuple(replace(sweep, squint=squint) for sweep in sweeps)


AXES = {"azimuth": (1,), "elevation": (2,), "both": (1, 2)}
# Standard deviation of the phase over the two-way beam with the default baseline. The phase of an echo of many
# scatterers gives their mean direction with an error of second order in this phase; the error from noise is inverse to
# it. Both are equal at some 25 dB of a point.
SCATTER_RAD = 0.25


def build_receivers(
    table: SecondReceiverTable | None, antenna: Antenna, chirp: Chirp, period_s: float
) -> MimoArray | None:
    """Return the array of a scenario's `second_receiver`: the first receiver and those beside it; None without one.

    period_s: from chirp to chirp.

    Raises ScenarioError for a baseline so long that the phase wraps inside the main lobe, or halves of an antenna
    without two cuts.
    """
    if table is None:
        return None
    axes, wavelength_m = AXES[table.axis], chirp.wavelength_m
    place_m, error_m = [np.zeros(3)], [np.zeros(3)]
    cuts = {}
    if table.kind == "monopulse":
        if not antenna.separable:
            message = "'monopulse' splits an antenna of two cuts into halves; set 'interferometer', or another antenna"
            raise ScenarioError.of("radar.second_receiver.kind", message)
        cuts = {axis: (antenna.azimuth, antenna.elevation)[axis - 1] for axis in axes}
    reach, spread = reach_of_power(antenna, UNAMBIGUOUS), two_way_spread(antenna)
    for axis in axes:
        # With both axes, the row of receivers is along the last one, elevation.
        in_row = table.receivers is not None and axis == axes[-1]
        max_wavelengths = 1 / (2 * reach[axis - 1])
        baseline = max_wavelengths / 2 if in_row else SCATTER_RAD / (2 * np.pi * spread[axis - 1])
        if table.baseline_wavelengths is not None and (in_row or table.receivers is None):
            baseline = table.baseline_wavelengths
        if baseline > max_wavelengths and not cuts:
            message = (
                f"{baseline:g} wraps the phase inside the main lobe, which reaches "
                f"{np.rad2deg(reach[axis - 1]):.2g} deg to either side; lower it to {max_wavelengths:.3g}"
            )
            raise ScenarioError.of("radar.second_receiver.baseline_wavelengths", message)
        unit = (np.arange(3) == axis) * (0.0 if cuts else wavelength_m)
        for multiple in range(1, (table.receivers or 2) if in_row else 2):
            place_m.append(multiple * baseline * unit)
            error_m.append(multiple * table.baseline_error_wavelengths * unit)
    error = np.exp(-1j * chirp.direction * np.deg2rad(table.phase_error_deg) * (np.arange(len(place_m)) > 0))
    return MimoArray(
        transmitter_m=np.zeros((1, 3)),
        receiver_m=np.array(place_m),
        true_receiver_m=np.array(place_m) + np.array(error_m),
        code=code_of("tdm", 1),
        blocks=1,
        period_s=period_s,
        wavelength_m=wavelength_m,
        direction=chirp.direction,
        mixing=np.diag(error),
        difference=tuple(difference_pattern(cut, axis) for axis, cut in cuts.items()),
    )


def build_array(table: ArrayTable, chirp: Chirp, period_s: float, seed: int) -> MimoArray:
    """Return an array with the errors that its calibration leaves.

    period_s: from chirp to chirp. seed: of these errors, which are those of one module.
    """
    wavelength_m = chirp.wavelength_m
    places = (table.transmitters_wavelengths, table.receivers_wavelengths)
    transmitter_m, receiver_m = (
        np.pad(np.array(place, dtype=np.float64), ((0, 0), (1, 0))) * wavelength_m for place in places
    )
    code = code_of(table.multiplexing, len(transmitter_m))
    random = pulse_generator(seed, Stream.CALIBRATION, 0)
    nepers = table.gain_error_db * np.log(10) / 20
    spread = nepers, np.deg2rad(table.phase_error_deg)
    sent, got = (
        np.exp(random.standard_normal((len(place), 2)) @ np.array([spread[0], 1j * spread[1]]))
        for place in (transmitter_m, receiver_m)
    )
    coupling = 0.0 if table.coupling_db is None else 10 ** (table.coupling_db / 20)
    exact = not any((table.gain_error_db, table.phase_error_deg, coupling))
    return MimoArray(
        transmitter_m=transmitter_m,
        receiver_m=receiver_m,
        code=code,
        blocks=table.chirps_per_frame // len(code),
        period_s=period_s,
        wavelength_m=wavelength_m,
        direction=chirp.direction,
        true_code=None if exact else code * sent,
        mixing=None if exact else receiver_mixing(receiver_m, got, coupling, wavelength_m),
    )


def build_chirp(radar: RadarTable) -> Chirp:
    """Return the chirp of a scenario; for a triangular sweep its rising half.

    Parameters
    ----------
    radar:
        Table `[radar]`.

    Returns
    -------
    The chirp; for a triangular sweep its rising half.
    """
    return build_sweeps(radar)[0]


def build_sweeps(radar: RadarTable) -> tuple[Chirp, ...]:
    """Return the sweeps of one period: a single one, or the two halves of a triangle, each with all samples."""
    pair = radar.sweep == "triangular"
    directions: tuple[Literal["up", "down"], ...]
    directions = ("up", "down") if radar.sweep == "triangular" else (radar.sweep,)
    full_sweeps = tuple(
        Chirp(
            carrier_hz=radar.carrier_hz,
            bandwidth_hz=radar.bandwidth_hz,
            rate_hz=radar.chirp_rate_hz * len(directions),
            samples=radar.samples_per_chirp,
            sweep=direction,
            sampling=radar.sampling,
            centre_s=(half - 0.5) / (2 * radar.chirp_rate_hz) if pair else 0.0,
            gate_s=1e-6 * radar.gate_delay_us,
        )
        for half, direction in enumerate(directions)
    )
    first, last = radar.used_samples
    return (
        full_sweeps
        if last - first == radar.samples_per_chirp
        else tuple(used(chirp, first, last) for chirp in full_sweeps)
    )


def array_antenna(table: ArrayAntennaTable) -> Antenna:
    """Return the antenna of a scenario's table, with its beam steered.

    Raises InputFileError if the table of elements, or the element's pattern, cannot be read.
    Raises ScenarioError if the array is too large, or its weights cancel.
    """
    positions, weights = read_elements(table.path) if table.path is not None else _rectangle(table)
    size = np.ptp(positions, axis=0) + 0.5
    if size.max() > LARGEST_WAVELENGTHS:
        message = f"{size.max():.0f} wavelengths are more than {LARGEST_WAVELENGTHS:g}; give fewer or closer elements"
        raise ScenarioError.of("radar.antenna", message)
    if abs(weights.sum()) < 0.1 * np.abs(weights).sum():
        message = "its weights nearly cancel toward the normal of its face; remove the steering from its phases"
        raise ScenarioError.of("radar.antenna", message)
    element: Pattern = ElementPattern(table.element_exponent)
    if table.element_pattern is not None:
        element = ANTENNA_PATTERN(table.element_pattern, "radar.antenna.element_pattern", table.element_boresight)
    broadside = antenna_of(
        ArrayPattern(array_factor(positions, weights), element, (float(size[0]), float(size[1]))),
        polarization=table.polarization,
        receives=table.receive_polarization,
        efficiency=from_db(table.efficiency_db),
    )
    if table.steer_deg == (0.0, 0.0):
        return broadside
    left_rad, up_rad = np.deg2rad(table.steer_deg)
    return steered(broadside, float(left_rad), float(up_rad))


def _rectangle(
    table: ArrayAntennaTable,
) -> tuple[Float[np.ndarray, "element 2"], Complex[np.ndarray, " element"]]:
    assert table.elements is not None  # the table's own check
    spacing = table.spacing_wavelengths
    steps = spacing if isinstance(spacing, tuple) else (spacing, spacing)
    axes = [(np.arange(n) - (n - 1) / 2) * step for n, step in zip(table.elements, steps, strict=True)]
    tapers = [line_taper(n, table.taper_db) for n in table.elements]
    left, up = np.meshgrid(*axes, indexing="ij")
    return np.column_stack([left.ravel(), up.ravel()]), np.outer(*tapers).ravel().astype(np.complex128)


def taylor_array(table: AntennaTable) -> Antenna:
    """Return the antenna of a scenario's table."""
    azimuth, elevation = table.beamwidths_rad
    return Antenna(
        taylor_cut(azimuth, table.side_lobe_db),
        taylor_cut(elevation, table.side_lobe_db),
        table.polarization,
        table.receive_polarization,
        table.axial_ratio_db,
    )


def measured_antenna(table: PatternAntennaTable) -> Antenna:
    """Return the antenna of a scenario's table.

    Raises InputFileError for a file that cannot be read.
    """
    transmit = ANTENNA_PATTERN(table.pattern, "radar.antenna.pattern", table.boresight)
    receive = None
    if table.receive_pattern is not None:
        receive = ANTENNA_PATTERN(table.receive_pattern, "radar.antenna.receive_pattern", table.boresight)
    return antenna_of(
        transmit,
        receive,
        polarization=table.polarization,
        receives=table.receive_polarization,
        axial_ratio_db=table.axial_ratio_db,
        efficiency=from_db(table.efficiency_db),
    )
