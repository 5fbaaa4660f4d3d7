"""Vegetation above the ground: attenuation of the ground's echo, and volume echo of the plants.

Each diffuse path to the ground stands for a solid angle, whose ray passes through the stands on its way. With the
extinction k (power, one way) and the cross-section eta per volume along it, the ground's echo passes with
exp(-2 tau), tau the integral of k, and a length ds of the ray returns, by the radar equation over the volume
s^2 dOmega ds,

    dP / P_t = lambda^2 G^2 eta dOmega ds / ((4 pi)^3 s^2) exp(-2 tau(s)),

where lambda^2 G^2 dOmega / (4 pi)^3 = |a|^2 r^2 cos(t) / sigma0(t) of the path a itself: an engine's paths suffice.
Over level ground this adds up to the water-cloud model (Attema and Ulaby 1978, "Vegetation modeled as a water
cloud"),

    sigma0 = eta cos(t) / (2 k) (1 - exp(-2 k h / cos t)) + sigma0_ground exp(-2 k h / cos t).

All of a ray's plants are one path, at a place drawn with their echo as weight, and with a phase that the wind turns;
both belong to the scatterer on the ground that the ray ends at, so that they stay where that one stays. The echo keeps
the co-polar polarization.
"""

from dataclasses import replace
from typing import no_type_check

import numpy as np
from jaxtyping import Float

from sionna_radar.flight.frames import MIN_GRAZING_SINE
from sionna_radar.flight.pulses import Pulses
from sionna_radar.foundation.compiled import compiled
from sionna_radar.foundation.randomness import Stream, place_uniforms
from sionna_radar.radar.chirp import Chirp
from sionna_radar.scene.model import Scene
from sionna_radar.scene.vegetation import PlantCover
from sionna_radar.surfaces.motion import Windblown
from sionna_radar.surfaces.radar_material import as_radar_material
from sionna_radar.tracing.paths import VEGETATION, Paths

# Steps along the part of each ray that may lie among plants.
STEPS = 96


class Canopy:
    """The vegetation of a scene, as it changes the paths to the ground."""

    def __init__(self, vegetation: PlantCover, scene: Scene, chirp: Chirp, seed: int, wind: Windblown) -> None:
        self._vegetation, self._seed, self._wind = vegetation, seed, wind
        self._wavelength_m = chirp.wavelength_m
        self._sigma0 = [as_radar_material(scene.materials[surface.material]).co_polar for surface in scene.surfaces]
        self._highest_m = vegetation.highest_m

    def over(self, paths: Paths, pulses: Pulses) -> Paths:
        """Return a block's paths, those to the ground dimmed, together with the echo of plants."""
        on_surfaces = np.flatnonzero(paths.surface >= 0)
        row = pulses.row_of(paths.pulse[on_surfaces])
        toward = pulses.true.position_m[row] - paths.hit_m[on_surfaces]
        range_m = np.linalg.norm(toward, axis=1)
        back = toward / range_m[:, None]
        cosine = np.cos(paths.incidence_rad[on_surfaces])
        shallow = np.maximum(np.minimum(cosine, np.abs(back[:, 2])), MIN_GRAZING_SINE)
        drawn = place_uniforms(self._seed, Stream.VEGETATION, paths.hit_m[on_surfaces], 5)
        least_m = np.minimum(self._highest_m / shallow, range_m * (1 - 1e-6))
        passed, returned, away_m = self._follow(paths.hit_m[on_surfaces], back, least_m, drawn[:, :2])
        gain = paths.gain.copy()
        gain[on_surfaces] *= np.sqrt(passed)
        dimmed = replace(paths, gain=gain)
        sigma0 = self._ground(paths.surface[on_surfaces], paths.incidence_rad[on_surfaces])
        seen = (returned > 0) & (sigma0 > 0)
        if not seen.any():
            return dimmed
        some, away = on_surfaces[seen], range_m[seen] - away_m[seen]
        beam = np.abs(paths.gain[some]) ** 2 * range_m[seen] ** 2 * cosine[seen] / sigma0[seen]
        power = beam * returned[seen] / away**2
        shift_hz = self._wind.shift_hz(drawn[seen, 3:])
        turns = drawn[seen, 2] + np.mod(shift_hz * pulses.time_s[row[seen]], 1.0)
        echo = Paths.to_points(
            pulses,
            row[seen],
            pulses.true.position_m[row[seen]] - back[seen] * away[:, None],
            gain=np.sqrt(power) * np.exp(2j * np.pi * turns),
            incidence_rad=np.full(len(some), np.nan),
            surface=np.full(len(some), VEGETATION),
        )
        echo = replace(echo, range_rate_mps=echo.range_rate_mps - shift_hz * self._wavelength_m / 2)
        return Paths.concatenate([dimmed, echo])

    def through(self, paths: Paths, pulses: Pulses) -> Paths:
        """Return paths to what is no diffuse ground, targets and mirrors, dimmed by the plants on their way."""
        if len(paths) == 0:
            return paths
        toward = pulses.true.position_m[pulses.row_of(paths.pulse)] - paths.hit_m
        range_m = np.maximum(np.linalg.norm(toward, axis=1), 1e-9)
        back = toward / range_m[:, None]
        least_m = self._highest_m / np.maximum(np.abs(back[:, 2]), MIN_GRAZING_SINE)
        least_m = np.minimum(least_m, range_m * (1 - 1e-6))
        passed, _, _ = self._follow(paths.hit_m, back, least_m, np.zeros((len(paths), 2)))
        return replace(paths, gain=paths.gain * np.sqrt(passed))

    def _follow(
        self,
        hit_m: Float[np.ndarray, "path 3"],
        back: Float[np.ndarray, "path 3"],
        least_m: Float[np.ndarray, " path"],
        drawn: Float[np.ndarray, "path 2"],
    ) -> Float[np.ndarray, "3 path"]:
        """Return plants' two-way transmission on rays, their echo, and its distance from the ground; see `follow`."""
        plants = self._vegetation
        return follow_rays(plants, hit_m, back, least_m, plants.extinction_per_m, plants.backscatter_per_m, drawn)

    def _ground(self, surface: np.ndarray, incidence_rad: Float[np.ndarray, " path"]) -> Float[np.ndarray, " path"]:
        """Return sigma0 of the surface that each path meets."""
        sigma0 = np.zeros(len(surface))
        for number in np.unique(surface):
            of_it = surface == number
            sigma0[of_it] = self._sigma0[number].sigma0(incidence_rad[of_it])
        return sigma0


def follow_rays(
    plants: PlantCover,
    hit_m: Float[np.ndarray, "path 3"],
    back: Float[np.ndarray, "path 3"],
    least_m: Float[np.ndarray, " path"],
    extinction_per_m: Float[np.ndarray, " stand"],
    backscatter_per_m: Float[np.ndarray, " stand"],
    drawn: Float[np.ndarray, "path 2"],
) -> Float[np.ndarray, "3 path"]:
    """Return the results of `follow` for rays through plants, whose stands have an extinction and a backscatter."""
    out = np.empty((3, len(hit_m)))
    follow(
        np.ascontiguousarray(hit_m, dtype=np.float64),
        np.ascontiguousarray(back),
        least_m,
        STEPS,
        (plants.grid.west_m, plants.grid.south_m),
        plants.grid.spacing_m,
        plants.stand,
        plants.top_m,
        plants.bottom_m,
        extinction_per_m,
        backscatter_per_m,
        np.ascontiguousarray(drawn),
        (out[0], out[1], out[2]),
    )
    return out


@compiled
@no_type_check
def follow(hit, back, least, steps, first, spacing, stand, top, bottom, extinction, backscatter, drawn, out):
    """Write, for rays that end at the ground, what plants along them pass and return.

    hit: where each ends; back: unit vectors from there to the radar; least: ranges from the ground that need no look.
    steps: so many equal steps are taken within each of these ranges; first, spacing: of the grid's cells.
    stand, top, bottom: the number of the stand in each cell, its top, and its lowest leaves.
    extinction, backscatter: of each stand.
    drawn: two numbers in [0, 1) for each ray.
    out: of each ray the share of power that passes, both ways; the integral of backscatter times what passes to there
        and back; and how far from the ground the place is that was drawn with that as its weight.
    """
    rows, columns = stand.shape
    west, south = first
    passed, returned, away = out
    weight = np.empty(steps)
    for ray in range(len(hit)):
        step = least[ray] / steps
        depth, total = 0.0, 0.0
        own, loss, mean = -1, 0.0, 1.0
        # From the radar's end of the range to the ground.
        for k in range(steps - 1, -1, -1):
            s = (k + 0.5) * step
            x = hit[ray, 0] + s * back[ray, 0]
            y = hit[ray, 1] + s * back[ray, 1]
            column = int(np.floor((x - west) / spacing + 0.5))
            row = int(np.floor((y - south) / spacing + 0.5))
            weight[k] = 0.0
            if row < 0 or column < 0 or row >= rows or column >= columns:
                continue
            z = hit[ray, 2] + s * back[ray, 2]
            if stand[row, column] < 0 or z >= top[row, column] or z < bottom[row, column]:
                continue
            if stand[row, column] != own:
                own = stand[row, column]
                loss = 2.0 * extinction[own] * step
                # Within the step the share falls exponentially, too.
                mean = (1.0 - np.exp(-loss)) / loss if loss > 1e-9 else 1.0
            weight[k] = backscatter[own] * step * np.exp(-depth) * mean
            total += weight[k]
            depth += loss
        passed[ray] = np.exp(-depth)
        returned[ray] = total
        away[ray] = 0.0
        if total > 0.0:
            wanted = drawn[ray, 0] * total
            for k in range(steps - 1, -1, -1):
                wanted -= weight[k]
                if wanted <= 0.0 and weight[k] > 0.0:
                    away[ray] = (k + drawn[ray, 1]) * step
                    break
