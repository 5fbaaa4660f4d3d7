"""The gamma engine: the paper's facet model, one scatterer on every facet in the beam.

Rouveure et al. 2017, section 3: the surface is a set of facets; each facet visible to the radar inside the
antenna's footprint is one scatterer of cross-section sigma0 A, and the echo is their coherent sum. Geometry,
index, amplitudes and phases use NumPy and SciPy, not Sionna. Only the shadow test is shared:
the scene's `RayCaster` (Mitsuba's ray casting) determines whether a facet's centre is visible.

Footprint: the directions where the outer envelope of the two-way pattern is above `FOOTPRINT_DB` of its peak.
With side lobes of -20 dB the directions outside contribute less than 0.001 dB to the echo of a uniform surface, and
less than 0.05 dB where everything outside is 20 dB brighter than everything inside.

Polarization: a facet scatters by the full matrix of its material, in its own plane of incidence; see
`facet_scattering`.

Facets too coarse for the beam or the range cell are divided until they are fine enough. With
persistent speckle a scatterer's phase depends on the seed and on the facet's position in the scene, so it is the same
from pulse to pulse, and with delays from float64 positions the phase history of the echo is that of a real, stationary
surface; otherwise every pulse draws new phases. Nearer than 7.5
range cells over the beamwidth (64 m for 2 deg and 0.3 m) the division depends on the distance: a facet whose
division changes gets new phases there, like a different surface.
"""

from collections.abc import Iterator
from copy import copy
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Complex, Float, Int, UInt64

from sionna_radar.flight.pulses import Pose, Pulses
from sionna_radar.foundation.columns import Columns
from sionna_radar.foundation.errors import Problem, ScenarioError
from sionna_radar.foundation.mixing import FIRST_STEP, split_mix, unit_of
from sionna_radar.radar.antenna import Antenna
from sionna_radar.radar.chirp import Chirp
from sionna_radar.scene.model import Scene
from sionna_radar.scene.raycast import RayCaster
from sionna_radar.tracing.engines.facet_index import FOOTPRINT_DB, FacetIndex, Footprint
from sionna_radar.tracing.engines.facet_mesh import Facets, Scatterers, facets_of
from sionna_radar.tracing.engines.facet_scattering import FacetScattering
from sionna_radar.tracing.paths import Paths
from sionna_radar.tracing.wander import wander_hz

# Longest side of a facet: this share of the half-power footprint, and this many range cells. At nadir,
# where the footprint is smallest, the echo of a plane is then within 0.03 dB of the integral.
BEAM_SHARE = 1 / 3
RANGE_CELLS = 2.5
FINEST_M = 1e-3
# Facets up to this many times too long are divided in one step.
MOST_PARTS = 4
# A facet's centre lies on the mesh it is tested against, to within the float32 precision of the ray caster.
SHADOW_TOLERANCE_M = 0.01
RAYS_AT_ONCE = 1_000_000
# Draws a facet's Doppler shift apart from its phases, whose steps are the numbers of pulses.
WANDER_STEP = np.array([2**63], dtype=np.uint64)
# Of one pulse: a gigabyte.
MOST_FACETS = 5_000_000


@dataclass(frozen=True, kw_only=True)
class _Echoes(Columns):
    """The echoes of one pulse's facets if none were occluded.

    gain: amplitude of each echo, with only the phase of its scattering matrix.
    """

    gain: Complex[np.ndarray, " facet"]
    away_m: Float[np.ndarray, "facet 3"]
    cos_incidence: Float[np.ndarray, " facet"]
    identity: UInt64[np.ndarray, " facet"]
    surface: Int[np.ndarray, " facet"]


class GammaEngine:
    """Traces pulses over facets; see the module docstring.

    Parameters
    ----------
    scene, antenna, chirp:
        The scene, and the radar that sees it.
    seed:
        Determines the phases of the facets.
    caster:
        Rays against the scene's surfaces, for the shadows.
    footprint_db:
        Two-way level relative to the peak down to which the beam counts.
    beam_share, range_cells:
        Longest side of a facet, in local half-power widths of the beam and in range resolutions.
    speckle:
        Whether the phases of the facets persist ("persistent") or every pulse draws new ones ("per_pulse").
    decorrelation_time_s:
        After which the field's correlation has fallen to 1 / e, see `wander`; None for a surface that stands still.

    """

    def __init__(
        self,
        scene: Scene,
        antenna: Antenna,
        chirp: Chirp,
        seed: int,
        caster: RayCaster,
        *,
        footprint_db: float = FOOTPRINT_DB,
        beam_share: float = BEAM_SHARE,
        range_cells: float = RANGE_CELLS,
        speckle: Literal["per_pulse", "persistent"] = "persistent",
        decorrelation_time_s: float | None = None,
    ) -> None:
        self._index = FacetIndex(facets_of(scene.surfaces))
        self._scene, self._footprint_db, self._beam_share = scene, footprint_db, beam_share
        self._two_sided = np.array([surface.two_sided for surface in scene.surfaces])
        self._footprint = Footprint.of(antenna, footprint_db)
        self._antenna, self._wavelength_m, self._caster = antenna, chirp.wavelength_m, caster
        self._side_per_metre = beam_share * min(antenna.beamwidths_rad)
        self._longest_side_m = range_cells * chirp.range_resolution_m
        self._scattering = FacetScattering(scene, antenna)
        self._speckle = speckle
        self._wander_hz = 0.0 if decorrelation_time_s is None else wander_hz(decorrelation_time_s)
        self._key = split_mix(np.array([seed], dtype=np.uint64), FIRST_STEP)

    def with_antenna(self, antenna: Antenna) -> "GammaEngine":
        """Return the engine with another antenna, over the same facets."""
        other = copy(self)
        other._antenna = antenna
        other._footprint = Footprint.of(antenna, self._footprint_db)
        other._side_per_metre = self._beam_share * min(antenna.beamwidths_rad)
        other._scattering = FacetScattering(self._scene, antenna)
        return other

    def trace(self, pulses: Pulses) -> Paths:
        """Return the paths of a block of pulses, one for each facet seen."""
        return Paths.concatenate([self._visible(pulses, *batch) for batch in self._batches(pulses)])

    def _batches(self, pulses: Pulses) -> Iterator[tuple[list[int], list[_Echoes]]]:
        """Yield rows of the block with their echoes, few enough for one wavefront of rays."""
        rows: list[int] = []
        found: list[_Echoes] = []
        count = 0
        for row in range(len(pulses)):
            rows.append(row)
            found.append(self._echoes(pulses.true, row))
            count += len(found[-1])
            if count > RAYS_AT_ONCE:
                yield rows, found
                rows, found, count = [], [], 0
        if rows:
            yield rows, found

    def _echoes(self, pose: Pose, row: int) -> _Echoes:
        """Return the echoes of the facets in the footprint of one pulse that face the radar.

        Their power is G^2 lambda^2 sigma0 A / ((4 pi)^3 r^4) (Rouveure et al. 2017, eq. 4 and 5).
        """
        position, R_world_antenna = pose.position_m[row], pose.R_world_antenna[row]
        facets = self._in_footprint(position, R_world_antenna)
        away, normal = facets.place_m - position, facets.normal_m2
        range_m = np.sqrt(np.einsum("fi,fi->f", away, away))
        twice_area = np.sqrt(np.einsum("fi,fi->f", normal, normal))
        toward = -np.einsum("fi,fi->f", normal, away)
        behind = (toward < 0) & self._two_sided[facets.surface]
        normal[behind], toward[behind] = -normal[behind], -toward[behind]
        facing = np.flatnonzero(toward > 0)
        away, range_m, twice_area = away[facing], range_m[facing], twice_area[facing]
        direction = away / range_m[:, None]
        antenna_gain = self._antenna.gain(direction @ R_world_antenna)
        amplitude = self._scattering.amplitude(
            direction,
            normal[facing] / twice_area[:, None],
            facets.surface[facing],
            facets.identity[facing],
            R_world_antenna,
        )
        spread = antenna_gain * self._wavelength_m * np.sqrt(twice_area / 2) / ((4 * np.pi) ** 1.5 * range_m**2)
        return _Echoes(
            gain=spread * amplitude,
            away_m=away,
            cos_incidence=np.minimum(toward[facing] / (twice_area * range_m), 1.0),
            identity=facets.identity[facing],
            surface=facets.surface[facing],
        )

    def _in_footprint(
        self, position_m: Float[np.ndarray, " 3"], R_world_antenna: Float[np.ndarray, "3 3"]
    ) -> Scatterers:
        """Return the facets whose centres lie in the footprint, the coarse ones divided until they are fine."""
        place = self._index.search(self._footprint, position_m, R_world_antenna)
        away = self._index.scatterers.place_m[place] - position_m
        parts = self._parts(self._index.side_m[place], away)
        radius = np.where(parts > 1, self._index.radius_m[place], 0.0)
        met = self._footprint.meets(away @ R_world_antenna, radius)
        whole = self._index.scatterers.rows(place[met & (parts == 1)])
        coarse = place[met & (parts > 1)]
        if not len(coarse):
            return whole
        return Scatterers.concatenate(
            [whole, *self._divided(self._index.facets.rows(coarse), position_m, R_world_antenna)]
        )

    def _divided(
        self, facets: Facets, position_m: Float[np.ndarray, " 3"], R_world_antenna: Float[np.ndarray, "3 3"]
    ) -> list[Scatterers]:
        """Return the parts of facets whose centres lie in the footprint, divided until they are fine."""
        fine: list[Scatterers] = []
        while len(facets):
            if len(facets) + sum(len(part) for part in fine) > MOST_FACETS:
                message = (
                    f"'gamma' divides the ground in one beam into more than {MOST_FACETS:,} facets; set 'sionna', or "
                    "give an antenna that sends less beside its beam"
                )
                raise ScenarioError([Problem("tracing.engine", message)])
            away = facets.centre_m - position_m
            side = np.sqrt(facets.squared_side_m2.max(axis=1))
            parts = self._parts(side, away)
            # No point of a triangle lies farther from its centroid than two thirds of the longest side.
            radius = np.where(parts > 1, 2 / 3 * side, 0.0)
            met = self._footprint.meets(away @ R_world_antenna, radius)
            fine.append(facets.rows(met & (parts == 1)).scatterers)
            few = met & (parts > 1) & (parts <= MOST_PARTS)
            for count in np.unique(parts[few]):
                pieces = facets.rows(few & (parts == count)).divided(int(count)).scatterers
                inside = self._footprint.meets((pieces.place_m - position_m) @ R_world_antenna, 0.0)
                fine.append(pieces.rows(inside))
            # Parts of very long facets outside the beam are dropped before they are divided in one step.
            facets = facets.rows(met & (parts > MOST_PARTS)).halved()
        return fine

    def _parts(
        self, side_m: Float[np.ndarray, " facet"], away_m: Float[np.ndarray, "facet 3"]
    ) -> Int[np.ndarray, " facet"]:
        """Return into how many parts the sides of facets are cut, by the longest and the distance of each."""
        longest = np.minimum(
            self._side_per_metre * np.sqrt(np.einsum("fi,fi->f", away_m, away_m)), self._longest_side_m
        )
        parts: Int[np.ndarray, " facet"] = np.ceil(side_m / np.maximum(longest, FINEST_M)).astype(np.int64)
        return parts

    def _visible(self, pulses: Pulses, rows: list[int], found: list[_Echoes]) -> Paths:
        """Return the paths of visible scatterers."""
        row = np.repeat(np.array(rows, dtype=np.int64), [len(f.gain) for f in found])
        together = _Echoes.concatenate(found)
        origin = pulses.true.position_m[row]
        point = origin + together.away_m
        seen = together.gain != 0
        if seen.any():
            seen[seen] = self._caster.visible(origin[seen], point[seen], SHADOW_TOLERANCE_M)
        turns = self._turn(together.identity[seen], pulses.index[row[seen]])
        if self._wander_hz:
            turns = turns + self._wander_hz * self._wander(together.identity[seen]) * pulses.time_s[row[seen]]
        phase = 2 * np.pi * np.mod(turns, 1.0)
        turn = np.empty(len(phase), dtype=np.complex128)
        turn.real, turn.imag = np.cos(phase), np.sin(phase)
        return Paths.to_points(
            pulses,
            row[seen],
            point[seen],
            gain=together.gain[seen] * turn,
            incidence_rad=np.arccos(together.cos_incidence[seen]),
            surface=together.surface[seen],
        )

    def _turn(
        self, identity: UInt64[np.ndarray, " path"], pulse: Int[np.ndarray, " path"]
    ) -> Float[np.ndarray, " path"]:
        """Return the phase of each facet at each pulse, in turns."""
        state = identity ^ self._key
        if self._speckle == "per_pulse":
            state = split_mix(state, pulse.astype(np.uint64) + np.uint64(1))
        return unit_of(state)

    def _wander(self, identity: UInt64[np.ndarray, " path"]) -> Float[np.ndarray, " path"]:
        """Return a number of the two-sided exponential distribution of mean size one for each facet."""
        share = 2 * unit_of(split_mix(identity ^ self._key, WANDER_STEP)) - 1
        return np.sign(share) * -np.log(np.maximum(1 - np.abs(share), 2.0**-60))
