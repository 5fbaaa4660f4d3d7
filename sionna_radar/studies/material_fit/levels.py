"""Levels of backscatter by cover, incidence and polarization, from traced or recorded echoes of a survey."""

from pathlib import Path

import numpy as np
from jaxtyping import Int
from scipy.special import gammaincc, gammaincinv

from sionna_radar.foundation.errors import InputFileError, ScenarioError
from sionna_radar.foundation.input_file import shown
from sionna_radar.foundation.sequences import spread_indices
from sionna_radar.inference.echo.likelihood import mean_ranges
from sionna_radar.inference.echo.speckle import repeats
from sionna_radar.studies.calibration.estimation import MIN_P_VALUE
from sionna_radar.studies.calibration.instrument_echoes import Readings
from sionna_radar.studies.calibration.recorded_echoes import echoes_of, signals_in
from sionna_radar.studies.material_fit.study import CROSS
from sionna_radar.surfaces.backscatter import Levels
from sionna_radar.survey.preparation import Prepared, prepare
from sionna_radar.survey.recording_source import open_recording

INCIDENCE_STEP_DEG, POLARIZATION_STEP_DEG = 5.0, 15.0
# Of the expected power of an echo that counts for a cover, the share that comes from it.
MIN_CLASS_FRACTION = 0.99
# Pulses traced at once.
BLOCK = 500


def measure_levels(prepared: Prepared, pulses: int = 2000, recording: Path | None = None) -> Levels:
    """Return levels of the covers of a survey, measured from traced or recorded echoes of some of its pulses.

    The power of an echo is that of the coherent sum of its paths, with speckle drawn for each pulse: one look; or that
    of the cells of a recorded profile less the noise, of as many looks as they are. It is divided by the power expected
    of ground of a sigma0 of 1, by the same antenna and over the same ground, and averaged over echoes of one cover in
    classes of incidence and polarization, without those that no speckle of the class explains, as of a target. The
    plane of incidence is taken as that of boresight and vertical, as over level ground. Antennas that receive across
    the wave give cross-polar levels. Traced echoes are without noise, targets, weather and errors of the radar; covers
    that are mirrors as well are left out.

    Parameters
    ----------
    prepared:
        The survey, with linear antennas.
    pulses:
        How many are taken at most, evenly over the flight.
    recording:
        Of beat signals of this flight, or a folder with one; None for traced echoes.

    Raises
    ------
    InputFileError, ScenarioError
        A recording of another flight, another polarization, or no echoes of a single cover.

    """
    scenario = prepared.scenario.replace({"tracing.speckle": "per_pulse"})
    antenna, tables = scenario.radar.antenna, scenario.all_materials
    if antenna.polarization not in ("V", "H"):
        raise ScenarioError.of("radar.antenna.polarization", f"{antenna.polarization!r} is not fitted; use 'V' or 'H'")
    cross = antenna.receive_polarization == "cross"
    same = {"model": "constant_gamma", "gamma_db": 0.0} | ({CROSS: 0.0} if cross else {})  # however the wave is turned
    uniform = {f"materials.{name}": same for name in tables}
    surveys = (prepare(scenario, prepared.custom), prepare(scenario.replace(uniform), prepared.custom))
    heard = None if recording is None else _recorded(recording, prepared)
    pulse = np.arange(len(prepared)) if heard is None else heard["pulse"]
    chosen = spread_indices(pulses, len(pulse))
    blocks = [_looks(*surveys, pulse[chosen[low : low + BLOCK]]) for low in range(0, len(chosen), BLOCK)]
    looks = {key: np.concatenate([block[key] for block in blocks]) for key in blocks[0]}
    looks |= {} if heard is None else {key: heard[key][chosen] for key in ("power", "variance", "reach")}
    # Beams that overlap share scatterers: fewer looks, also where a neighbour is of another class.
    repeated = repeats(looks["reach"] * len(chosen) / len(pulse))
    looks["sigma0"] = looks["power"] / looks["unit"]
    mirrors = [name for name, table in tables.items() if getattr(table, "specular", False)]
    groups: dict[tuple[str, int, int], list[int]] = {}
    for k in np.flatnonzero(~np.isin(looks["cover"], ["", *mirrors])):
        angle = int(np.rad2deg(looks["incidence_rad"][k]) // INCIDENCE_STEP_DEG)
        turn = round(np.rad2deg(looks["polarization_rad"][k]) / POLARIZATION_STEP_DEG)
        groups.setdefault((str(looks["cover"][k]), angle, turn), []).append(int(k))
    if not groups:
        message = f"no echo has {MIN_CLASS_FRACTION:.0%} of its power from one cover without a mirror; narrow the beam"
        raise ScenarioError.of("terrain", message)
    found, count, sums = sorted(groups), [], np.zeros((91, 2))
    for key in found:
        own = np.array(groups[key])
        # The mean square of a power is that of its mean and its variance; a target is in no median.
        square, variance, level = looks["power"][own] ** 2, looks["variance"][own], looks["sigma0"][own]
        each = max(float(np.median(square / variance)) - 1, 1.0)
        mean = float(np.median(level)) * each / gammaincinv(each, 0.5)
        kept = gammaincc(each, each * level / mean) > MIN_P_VALUE / len(looks["cover"])
        groups[key] = own[kept].tolist()
        count.append(kept.sum() / repeated[own][kept].mean())
        sums[key[1]] += np.array([square[kept].sum(), variance[kept].sum()]) / np.median(looks["power"][own]) ** 2
    # Bright speckle has fewer looks and would weigh less, so those of an echo are of all classes at its incidence.
    square, variance = sums[[angle for _, angle, _ in found]].T
    columns = ("incidence_rad", "polarization_rad", "sigma0")
    means = {name: np.array([looks[name][groups[key]].mean() for key in found]) for name in columns}
    means |= {"looks": np.array(count) * np.maximum(square / variance - 1, 1.0), "cross": np.full(len(found), cross)}
    return Levels(cover=tuple(cover for cover, _, _ in found), **means)


def _recorded(recording: Path, prepared: Prepared) -> dict[str, np.ndarray]:
    """Return a recording's pulses with an echo: power over that transmitted, variance by speckle, pulses it repeats."""
    with open_recording(signals_in(recording), {}) as source:
        echoes = echoes_of(source).echoes
        if isinstance(echoes, Readings) or len(source.file.pulses) != len(prepared):
            message = f"{shown(recording)}: is no recording of signals of the {len(prepared)} pulses of this flight"
            raise InputFileError(message)
    profiles, middle = echoes.sightings.profiles, float(echoes.sightings.response.max())
    row = np.repeat(np.arange(len(profiles)), np.diff(profiles.start))
    cells = profiles.power - profiles.noise[row]
    total = np.bincount(row, cells)
    # Exponential powers have twice the mean square of their means.
    variance = np.bincount(row, cells**2 / 2) / echoes.sightings.looks_per_cell
    scale = middle / prepared.receiver.transmit_power_w
    reach = echoes.sightings.repeated(mean_ranges(echoes.sightings).range_m, of_power=True)
    power = np.maximum(total, 0.0) * scale
    return {"pulse": profiles.pulse, "power": power, "variance": variance * scale**2, "reach": reach}


def _looks(survey: Prepared, uniform: Prepared, index: Int[np.ndarray, " pulse"]) -> dict[str, np.ndarray]:
    """Return power and variance of each echo, the power of a sigma0 of 1, angles, and the cover if it is single."""
    paths, flat = (each.rows(each.surface >= 0) for each in (survey.paths(index), uniform.paths(index)))
    field = np.zeros(len(index), dtype=np.complex128)
    np.add.at(field, np.searchsorted(index, paths.pulse), paths.gain)
    row = np.searchsorted(index, flat.pulse)
    # Of a constant gamma of 1, sigma0 is the cosine.
    weight = np.abs(flat.gain.astype(np.complex128)) ** 2 / np.maximum(np.cos(flat.incidence_rad), 1e-9)
    covers, kind = np.unique([surface.material for surface in survey.world.scene.surfaces], return_inverse=True)
    share = np.zeros((len(index), len(covers)))
    np.add.at(share, (row, kind[flat.surface]), weight)
    total = share.sum(axis=1)
    single = (total > 0) & (share.max(axis=1) >= MIN_CLASS_FRACTION * total)
    pose = survey.flight.pulses(index).true
    # Sionna's vertical polarization lies along the antenna's third axis, the horizontal one along its second.
    electric = pose.R_world_antenna[:, :, 2 if survey.scenario.radar.antenna.polarization == "V" else 1]
    across = np.cross(pose.boresight, [0.0, 0.0, 1.0])
    along = np.cross(across, pose.boresight)
    outside, inside = (np.abs(np.sum(electric * axis, axis=1)) for axis in (across, along))
    incidence = np.bincount(row, weight * flat.incidence_rad, minlength=len(index))
    whole, power = np.where(single, total, 1.0), np.abs(field) ** 2
    return {
        "power": power,
        "unit": whole,
        "variance": power**2 / 2,
        "reach": np.zeros(len(index)),  # drawn for each pulse
        "incidence_rad": incidence / whole,
        "polarization_rad": np.arctan2(outside, inside),
        "cover": np.where(single, covers[share.argmax(axis=1)], ""),
    }
