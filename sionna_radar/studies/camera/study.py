"""Frames of a camera at the place of the radar: the same world, flight and weather, by the sun or at night."""

import logging
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, UInt8

from sionna_radar.foundation.errors import ScenarioError, named_after
from sionna_radar.foundation.progress import advance, stage
from sionna_radar.foundation.randomness import Stream, pulse_generator
from sionna_radar.scenario import Scenario
from sionna_radar.scenario.radar import PanoramicScanTable
from sionna_radar.scene.model import Scene
from sionna_radar.scene.raycast import Hits
from sionna_radar.signal.build import build_optical_air
from sionna_radar.studies.camera import optics
from sionna_radar.studies.panorama.study import Drive, plan_drive
from sionna_radar.survey.preparation import Prepared, prepare
from sionna_radar.weather.optical import KOSCHMIEDER, VISIBLE_NM

logger = logging.getLogger("sionna_radar")

# Start of shadow rays above the surface, which they must not meet again.
SHADOW_OFFSET_M = 0.05
UNSEEN = ("vegetation", "targets", "wires", "poles", "fences")


@dataclass(frozen=True, kw_only=True)
class Frame:
    """One frame.

    luminance_cd_m2: of each pixel, without noise. range_m: to the ground; infinite for the sky.
    image: grey levels of a screen, from 0 to 255.
    contrast, noise: standard deviation of the ground's luminance between pixels, and of a pixel by shot and read noise,
        over the mean; NaN without ground.
    """

    time_s: float
    position_m: Float[np.ndarray, " 3"]
    luminance_cd_m2: Float[np.ndarray, "row column"]
    range_m: Float[np.ndarray, "row column"]
    image: UInt8[np.ndarray, "row column"]
    exposure_s: float
    contrast: float
    noise: float

    @property
    def ground(self) -> Bool[np.ndarray, "row column"]:
        """Mask of the pixels that do not show the sky."""
        return np.isfinite(self.range_m)


@dataclass(frozen=True, kw_only=True)
class Film:
    """Frames of a flight, and the extinction of the air in the visible."""

    scenario: Scenario
    frames: tuple[Frame, ...]
    extinction_per_m: float
    warnings: tuple[str, ...] = ()

    def __repr__(self) -> str:
        name = self.scenario.description or "no description"
        return f"Film: {name}\n  {len(self.frames)} frames, visibility {self.visibility_m:.3g} m"

    @property
    def visibility_m(self) -> float:
        """Range at which a black target keeps 2 % of its contrast against the horizon (Koschmieder 1924)."""
        return KOSCHMIEDER / self.extinction_per_m if self.extinction_per_m > 0 else np.inf


def camera(scenario: Scenario) -> Film:
    """Return the frames of a camera at the place of the radar along the flight of a scenario.

    Parameters
    ----------
    scenario:
        The flight, or the drive of a panoramic radar; `camera` has the lens, the light and the exposure. Its sensor may
        be any.

    Returns
    -------
    Frames with luminances in cd/m2 and ranges in m.

    Raises
    ------
    ScenarioError, InputFileError
        Rain that differs from place to place, fog without a visibility, or a scenario that cannot be flown; see
        `prepare`.

    Examples
    --------
    >>> film = camera(load_scenario("hills", {"camera": {"frames": 2, "pixels": [32, 24]}, "platform.length_m": 10.0}))
    >>> film.frames[0].image.shape, film.visibility_m
    ((24, 32), inf)
    """
    _check(scenario)
    with named_after(scenario.source):
        flown = _flown(scenario.replace({"sensor": "radar"}) if scenario.sensor == "camera" else scenario)
    view, frames = _View(flown), list[Frame]()
    with stage("filming", scenario.camera.frames):
        for time_s in np.linspace(flown.flight.time_s[0], flown.flight.time_s[-1], scenario.camera.frames):
            frames.append(view.frame(len(frames), float(time_s)))
            advance()
    warnings, unseen = list(flown.warnings), [f"[[{name}]]" for name in UNSEEN if getattr(scenario, name)]
    if unseen:
        warnings.append(f"the camera does not show {' and '.join(unseen)}; remove them to compare it with a radar")
        logger.warning("%s", warnings[-1])
    return Film(
        scenario=scenario,
        frames=tuple(frames),
        extinction_per_m=view.extinction_per_m,
        warnings=tuple(warnings),
    )


def _flown(scenario: Scenario) -> Prepared | Drive:
    """Return a prepared survey, or a drive with a panoramic scan, which maps no heights."""
    return plan_drive(scenario) if isinstance(scenario.radar.scan, PanoramicScanTable) else prepare(scenario)


def _check(scenario: Scenario) -> None:
    weather = scenario.weather
    for key in ("rain_cell", "rain_field"):
        if getattr(weather, key) is not None:
            message = "rain that varies from place to place is not modelled for a camera; remove it"
            raise ScenarioError.of(f"weather.{key}", message, scenario.source)
    if weather.liquid_water_g_per_m3 > 0 and weather.fog_visibility_m is None:
        message = f"{weather.liquid_water_g_per_m3:g} does not tell how far one sees; give weather.fog_visibility_m"
        raise ScenarioError.of("weather.liquid_water_g_per_m3", message, scenario.source)


class _View:
    """The view of a camera into a world along a way."""

    def __init__(self, flown: Prepared | Drive) -> None:
        self._flown, self._table, scene = flown, flown.local.camera, flown.world.scene
        self._light, self._direction = optics.light_of(self._table), optics.pixel_directions(self._table)
        albedos = optics.VISIBLE_ALBEDO | self._table.albedos
        self._albedo = np.array([albedos.get(s.material, albedos["ground"]) for s in scene.surfaces])
        self.extinction_per_m = build_optical_air(flown.local.weather, VISIBLE_NM).extinction_per_m

    def frame(self, number: int, time_s: float) -> Frame:
        """Return the frame of a time; `number` is the key of its noise."""
        position, _, R_world_mount = (each[0] for each in self._flown.flight.mount(np.array([time_s])))
        direction = self._direction.reshape(-1, 3) @ R_world_mount.T
        hits = self._flown.world.caster.cast(np.broadcast_to(position, direction.shape), direction)
        luminance = np.full(len(direction), self._light.sky_cd_m2)
        luminance[hits.hit] = seen = self._seen(position, direction, hits)
        shape = self._direction.shape[:2]
        generator = pulse_generator(self._flown.local.seed, Stream.CAMERA, number)
        image, exposure_s = optics.expose(luminance.reshape(shape), self._table, generator)
        mean = float(seen.mean()) if len(seen) else np.nan
        electrons = mean * optics.electrons_per_cd_m2(self._table, exposure_s)
        return Frame(
            time_s=time_s,
            position_m=position,
            luminance_cd_m2=luminance.reshape(shape).astype(np.float32),
            range_m=hits.distance_m.reshape(shape).astype(np.float32),
            image=image,
            exposure_s=exposure_s,
            contrast=float(seen.std()) / mean if len(seen) else np.nan,
            noise=float(np.sqrt(electrons + optics.READ_NOISE_ELECTRONS**2) / electrons),
        )

    def _seen(
        self, position: Float[np.ndarray, " 3"], direction: Float[np.ndarray, "ray 3"], hits: Hits
    ) -> Float[np.ndarray, " hit"]:
        """Return the luminance of the pixels with a hit, as seen through the air."""
        caster, light, range_m = self._flown.world.caster, self._light, hits.distance_m[hits.hit]
        normal, toward_surface = normals(self._flown.world.scene, hits), direction[hits.hit]
        normal *= -np.sign(np.einsum("ri,ri->r", normal, toward_surface))[:, None]
        start = position + range_m[:, None] * toward_surface + SHADOW_OFFSET_M * normal
        sunlit = (normal @ light.toward_sun > 0) & (light.sun_lx > 0)
        sunlit[sunlit] = ~caster.cast(start[sunlit], np.broadcast_to(light.toward_sun, start[sunlit].shape)).hit
        surface = optics.surface_luminance(light, self._albedo[hits.surface[hits.hit]], normal, sunlit)
        return optics.through_air(surface, range_m, light.sky_cd_m2, self.extinction_per_m)


def normals(scene: Scene, hits: Hits) -> Float[np.ndarray, "hit 3"]:
    """Return unit normals of the triangles that rays hit, outward of closed surfaces."""
    number, face = hits.surface[hits.hit], hits.face[hits.hit]
    normal = np.empty((len(number), 3))
    for index, surface in enumerate(scene.surfaces):
        a, b, c = np.moveaxis(surface.vertices_m[surface.faces[face[number == index]]], 1, 0)
        normal[number == index] = np.cross(b - a, c - a)
    return normal / np.linalg.norm(normal, axis=1, keepdims=True)
