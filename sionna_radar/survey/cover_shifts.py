"""Echoes shifted by covers of the ground of different backscatter; the warning about maps that do not model them."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from sionna_radar.foundation.decibels import to_db
from sionna_radar.foundation.raster import Raster
from sionna_radar.inference.echo.beam import beam_samples
from sionna_radar.scenario.bases import CoveredTerrain
from sionna_radar.scene.terrains.build import cover_of
from sionna_radar.survey.observation import Observed
from sionna_radar.survey.preparation import Prepared

# Beams, and rays across each, by which covers are looked for; the share of them that covers must move for a warning.
COVER_BEAMS, COVER_RAYS, MOVED_FRACTION_WARNED = 1000, 200, 0.01
# A cover darker by more is as good as silent, as calm water is.
SILENT_DB = 60
# Along a ray beyond the foot of a wall, from which the roof is straight above.
BEHIND_M = 0.1


@dataclass(frozen=True)
class CoverShifts:
    """By how much the covers under each of some beams move its echo; see `cover_shifts`.

    place_m: where the axis meets level ground at the height of the footprint.
    shift_m: error of the height by the echo; positive where that is too high.
    ratio: of the brightest to the darkest cover in the beam, in power; brightest, darkest: their names.
    incidence_rad: of the axis on level ground.
    """

    place_m: Float[np.ndarray, "beam 2"]
    shift_m: Float[np.ndarray, " beam"]
    ratio: Float[np.ndarray, " beam"]
    brightest: Sequence[str]
    darkest: Sequence[str]
    incidence_rad: Float[np.ndarray, " beam"]


def cover_shifts(prepared: Prepared) -> CoverShifts | None:
    """Return the shifts of echoes by covers of the ground of different backscatter; None where all are the same.

    The mean range of an echo is that of its power: weighted by gamma = sigma0 / cos(incidence) of each cover, at the
    incidence of the beam's axis on level ground, less what it is for one cover. Across a border in the middle of a
    Gaussian beam of standard deviation s in range, of two covers of the ratio q, that is sqrt(2 / pi) s (q - 1) /
    (q + 1). Objects count where they lie no higher than a range cell above the ground, as roads do; buildings do not.
    """
    scene, beam = prepared.world.scene, prepared.mapper.beam
    materials = sorted({surface.material for surface in scene.surfaces})
    if beam is None or len(materials) == 1 or prepared.angle is not None:
        return None
    pose = prepared.flight.sample(COVER_BEAMS).true
    inner, weight = beam_samples(beam, COVER_RAYS)
    direction = np.einsum("pij,kj->pki", pose.R_world_antenna, inner).reshape(-1, 3)
    origin_m = np.repeat(pose.position_m, len(inner), axis=0)
    hits = prepared.world.caster.cast(origin_m, direction)
    place_m = origin_m + np.where(hits.hit, hits.distance_m, np.nan)[:, None] * direction
    terrain = np.array([surface.name.startswith("terrain-") and not surface.divided for surface in scene.surfaces])
    lies = hits.hit & terrain[hits.surface]
    # Of anything else what is low, and has nothing high right behind it as the foot of a wall has.
    other = np.flatnonzero(hits.hit & ~lies)
    ground_m, behind_m = prepared.world.ground_m, place_m[other, :2] + BEHIND_M * direction[other, :2]
    behind_top_m = prepared.world.top_m(behind_m) - ground_m(behind_m)
    above_m = np.maximum(np.abs(place_m[other, 2] - ground_m(place_m[other, :2])), np.abs(behind_top_m))
    lies[other] = above_m < prepared.receiver.chirp.range_resolution_m
    lies = lies.reshape(len(pose), -1)

    down = np.clip(-pose.boresight[:, 2], 0.02, 1.0)
    incidence_rad = np.arccos(down)
    gamma = np.array([scene.materials[name].sigma0(incidence_rad) / down for name in materials])
    number = np.searchsorted(materials, [surface.material for surface in scene.surfaces])[hits.surface].reshape(
        lies.shape
    )
    range_m = np.where(lies, hits.distance_m.reshape(lies.shape), 1.0)
    power = np.where(lies, weight / range_m**2, 0.0)
    level = np.take_along_axis(np.maximum(gamma, np.finfo(float).tiny).T, number, axis=1)

    def mean_m(power: Float[np.ndarray, "beam ray"]) -> Float[np.ndarray, " beam"]:
        total = power.sum(axis=1)
        return (power * range_m).sum(axis=1) / np.where(total > 0, total, np.nan)

    plain_m = mean_m(power)
    brightest, darkest = (np.where(lies, sign * level, -np.inf).argmax(axis=1) for sign in (1, -1))
    each, met = np.arange(len(pose)), np.isfinite(plain_m)
    return CoverShifts(
        place_m=(pose.position_m + plain_m[:, None] * pose.boresight)[met, :2],
        shift_m=((plain_m - mean_m(power * level)) * down)[met],
        ratio=(level[each, brightest] / level[each, darkest])[met],
        brightest=[materials[number[beam, ray]] for beam, ray in zip(each[met], brightest[met], strict=True)],
        darkest=[materials[number[beam, ray]] for beam, ray in zip(each[met], darkest[met], strict=True)],
        incidence_rad=incidence_rad[met],
    )


def cover_warnings(shifts: CoverShifts | None, error: Raster, sigma: Raster | None, remedy: str) -> Iterator[str]:
    """Yield the warning about beams over covers of different backscatter, which a map does not model.

    Told where more than a share of the beams are moved by more than two standard deviations, and the map follows them
    by more than one: a map that has found level ground knows better than some of its echoes. A map that has learned
    strong covers as relief states that: then the error left without what follows the covers stands for its sigma.
    """
    if shifts is None or sigma is None:
        return
    row, column, inside = sigma.grid.cell_of(shifts.place_m)
    filled = np.flatnonzero(inside & np.isfinite(error.height_m[row, column]))
    stated_m, error_m = (each.height_m[row, column][filled] for each in (sigma, error))
    off_m, ratio = shifts.shift_m[filled], shifts.ratio[filled]
    if not off_m.any():
        return
    rest_m = error_m - off_m * (error_m @ off_m) / (off_m @ off_m)
    usual_m = np.minimum(stated_m, np.sqrt(np.mean(rest_m**2)))
    moved = np.abs(off_m) > 2 * usual_m
    fraction, followed = np.mean(moved), error_m[moved] @ off_m[moved]
    if fraction > MOVED_FRACTION_WARNED and followed > np.linalg.norm(off_m[moved]) * np.linalg.norm(usual_m[moved]):
        most = filled[moved][np.argmax(ratio[moved])]
        ratio_db = to_db(shifts.ratio[most])
        contrast = f"up to {ratio_db:.0f} dB" if ratio_db < SILENT_DB else f"more than {SILENT_DB} dB"
        rms_m, sigma_m = (np.sqrt(np.mean(values_m[moved] ** 2)) for values_m in (error_m, stated_m))
        yield (
            f"covers of the ground differ by {contrast} ({shifts.brightest[most]!r} over {shifts.darkest[most]!r} at "
            f"{np.rad2deg(shifts.incidence_rad[most]):.0f} deg), and the echo of a beam over both is that of the "
            f"brighter: in {fraction:.0%} of the beams heights err by {rms_m:.2g} m RMS, where `dem_sigma.tif` states "
            f"{sigma_m:.2g} m; {remedy}"
        )


def cover_remedy(prepared: Prepared, observed: Observed) -> str | None:
    """Return the remedy for a map that does not know the covers of the ground; None for one that does."""
    mapper, terrain = prepared.mapper, prepared.local.terrain
    unaware = not mapper.keeps_profiles or (mapper.name == "smooth" and observed.behind_volume)
    keys = (["dem.method = 'refined'"] if unaware else []) + (["dem.cover = 'known'"] if mapper.cover is None else [])
    if not keys:
        return None
    if not isinstance(terrain, CoveredTerrain) or (observed.profiles is None and mapper.keeps_profiles):
        return "narrow the beam, or fly lower"
    name = "name them in terrain.cover and " if cover_of(terrain).bare else ""
    return f"{name}set {' and '.join(keys)}, or narrow the beam"
