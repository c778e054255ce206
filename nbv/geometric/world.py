"""What the geometric fidelity knows of a rock: landmarks, surface samples, and who can see them.

Points, and who of the default viewpoints sees them, are computed once per rock and kept in the store; what other viewpoints
see, when they are first visited. Visibility is that from nominal positions: an arrival error of some 12 cm at 3.5 m moves an
outline by a centimetre or two. Angles and incidences use the actual positions.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, cached_property, lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from nbv.cache import Arrays, Recent, Store, cached
from nbv.config import CameraConfig, MissionConfig
from nbv.config.sections_planning import SharedTermsConfig
from nbv.evaluation.ground_truth import measured_faces, observable_mask
from nbv.geometry.mesh import vertex_normals
from nbv.geometry.raycasting import RayCaster, rays_of
from nbv.geometry.sampling import sample_surface
from nbv.geometry.visibility import (
    LANDMARK_MAX_INCIDENCE_DEG,
    OBSERVABLE_MAX_INCIDENCE_DEG,
    in_frustum,
    seen_from,
)
from nbv.random_streams import keyed_rng
from nbv.rocks import Rock
from nbv.rocks.families import generated_name
from nbv.scene.bake import direction_to_sun
from nbv.types import Bools, Floats, Point
from nbv.viewpoints import camera_shell

SURFACE_SAMPLES = 3_000
ROCK_LANDMARKS = 1_800  # candidates on the rock; most are too faint to be detected often
GROUND_MARGIN_M = 0.05  # near ground reaches this far beyond the planners' box, or a larger default one
GROUND_SPACING_M = 0.118
FAR_LANDMARKS = 1_000
FAR_RADIUS_M = 30.0
TEXTURE_RADIUS_M = 0.03  # a feature's neighbourhood
TEXTURE_NEIGHBOURS = 48
SAMPLE_NEIGHBOURS = 16
LIFT_M = 1e-3  # of a ray off the facet that it starts from; with it the model was calibrated


DEFAULT_FOCAL_PX = CameraConfig().focal_px  # with which the model was calibrated
MAX_VIEWS = 1_000  # views of one world that are kept in memory, 7 kB each


def resolution(camera: CameraConfig) -> float:
    """How fine the image is: the length of a pixel on the surface with the camera of the calibration over that with ``camera``."""
    return camera.focal_px / DEFAULT_FOCAL_PX


def resolved(chance: Floats, camera: CameraConfig, power: float) -> Floats:
    """Chances of the calibration's camera with another, whose pixels are n times as long: of n to that power such events at once."""
    return chance if resolution(camera) == 1.0 else chance ** (resolution(camera) ** -power)


@dataclass(frozen=True)
class GeometricWorld:
    """Arrays of one rock; L landmarks, S surface samples.

    Landmarks are sorted: rock, near ground, far ground (the last only matters to statistics over the
    whole sparse cloud).
    """

    landmarks_m: Floats  # (L, 3)
    landmark_normals: Floats  # (L, 3)
    landmark_contrast: Floats  # (L,) local standard deviation of the shaded albedo, 0 to 1
    n_rock: int
    n_near: int  # rock and near ground
    samples_m: Floats  # (S, 3) of the whole surface, uniform by area
    sample_normals: Floats  # (S, 3)
    sample_contrast: Floats  # (S,)
    observable: Bools  # (S,) what `nbv.evaluation` counts as observable
    sample_neighbours: NDArray[np.int32]  # (S, K) nearest samples, the sample itself first
    sample_distances_m: Floats  # (S, K)
    shell_m: Floats  # (V, 3) default viewpoints, aimed at `aim_m`; none of a drawn rock, of which aims differ
    shell_landmarks: Bools  # (V, L) what they see
    shell_samples: Bools  # (V, S)
    aim_m: Point
    caster: Callable[[], RayCaster]  # of the rock, made when it is first needed
    camera: CameraConfig

    @cached_property
    def seed_models(self) -> Recent[Any]:
        """What `nbv.geometric.reconstructor` makes of seeds: the same for all configurations with these seeds."""
        return Recent(8)

    @cached_property
    def landmarks_seen(self) -> Callable[[Point, Point], Bools]:
        """(L,) landmarks that a camera at a nominal position, aimed at a point, has in its image, front side, not hidden."""
        return self._visibility(
            self.landmarks_m, self.landmark_normals, LANDMARK_MAX_INCIDENCE_DEG, self.shell_landmarks
        )

    @cached_property
    def samples_seen(self) -> Callable[[Point, Point], Bools]:
        """(S,) samples, as `landmarks_seen` has it."""
        return self._visibility(
            self.samples_m, self.sample_normals, OBSERVABLE_MAX_INCIDENCE_DEG, self.shell_samples
        )

    def _visibility(
        self, points_m: Floats, normals: Floats, max_incidence_deg: float, of_shell: Bools
    ) -> Callable[[Point, Point], Bools]:
        starts = points_m + LIFT_M * normals
        rows = {tuple(position): row for row, position in enumerate(self.shell_m.tolist())}

        def visible(position_m: Point, aim_m: Point) -> Bools:
            row = rows.get(position_m) if aim_m == self.aim_m else None
            if row is not None:
                known: Bools = of_shell[row]
                return known
            center = np.array(position_m)
            seen = in_frustum(points_m, center[None], np.array(aim_m), self.camera)[:, 0] & (
                points_m[:, 2] >= 0
            )
            ask = np.flatnonzero(seen)
            seen[ask] = seen_from(center, starts[ask], normals[ask], self.caster(), max_incidence_deg)
            return seen

        return lru_cache(MAX_VIEWS)(visible)

    @cached_property
    def reach_counts(self) -> Callable[[float], NDArray[np.intp]]:
        """(S,) how many of each sample's listed neighbours, itself included, are nearer than a distance in metres."""
        return cache(lambda t_m: (self.sample_distances_m < t_m).sum(axis=1))

    @cached_property
    def neighbours_by_rank(self) -> NDArray[np.intp]:
        """(K, S) `sample_neighbours`: every sample's nearest (itself), every sample's second nearest, ..."""
        return np.ascontiguousarray(self.sample_neighbours.T, dtype=np.intp)


WORLDS: Recent[GeometricWorld] = Recent(16)  # in this process's memory: a campaign comes back to its rocks


def world_of(rock: Rock, config: MissionConfig, store: Store | None) -> GeometricWorld:
    """The rock's world: from memory, from the store, or made."""
    scale = (config.target_m, _near_m(config))
    key = (rock.sha256, config.camera, config.scene, config.evaluation, *scale)
    return WORLDS.get(key, lambda: _stored_world(rock, config, store))


def _stored_world(rock: Rock, config: MissionConfig, store: Store | None) -> GeometricWorld:
    scene = config.scene
    inputs = [
        rock.sha256,
        config.camera,
        list(config.target_m),
        _near_m(config),
        [list(scene.sun_travel), scene.sun_irradiance, scene.ambient],
        camera_shell(config),
        config.evaluation,
    ]

    @cache
    def caster() -> RayCaster:
        return RayCaster(rock.vertices_m, rock.faces)

    def made(arrays: Arrays) -> GeometricWorld:
        plain: dict[str, Any] = {name: int(arrays[name]) for name in ("n_rock", "n_near")}
        fixed = {"aim_m": config.target_m, "caster": caster, "camera": config.camera}
        return GeometricWorld(**{**arrays, **plain, **fixed})

    def build() -> Arrays:
        arrays = _build(rock, config, caster())
        positions = camera_shell(config)[: 0 if generated_name(rock.name) else None]
        nothing = {name: np.zeros((0, 0)) for name in ("shell_m", "shell_landmarks", "shell_samples")}
        world = made({**arrays, **nothing})
        visibility = {"shell_landmarks": world.landmarks_seen, "shell_samples": world.samples_seen}
        seen = {
            name: np.array([visible(tuple(p), config.target_m) for p in positions.tolist()])
            for name, visible in visibility.items()
        }
        return {**arrays, "shell_m": positions, **seen}

    return made(cached(store, "geometric-worlds", build, code=__name__, inputs=inputs))


def _build(rock: Rock, config: MissionConfig, caster: RayCaster) -> Arrays:
    """Landmarks and samples of one rock, and which samples can be observed."""
    shade = _Shading(rock, config, caster)

    measured = measured_faces(rock.vertices_m, rock.faces, config.evaluation)
    samples, sample_normals = sample_surface(rock.vertices_m, measured, SURFACE_SAMPLES, 0)
    observable = observable_mask(caster, samples, sample_normals, camera_shell(config))

    on_rock, rock_normals = sample_surface(rock.vertices_m, rock.faces, ROCK_LANDMARKS, 1)
    above = on_rock[:, 2] > 0
    on_rock, rock_normals = on_rock[above], rock_normals[above]
    near_m = _near_m(config)
    near, far = _near_ground(near_m), _far_ground(near_m)
    ground = np.concatenate([near, far])
    ground = ground[~_under_rock(caster, ground)]
    n_near = len(on_rock) + int((np.abs(ground[:, :2]).max(axis=1) <= near_m).sum())
    landmarks = np.concatenate([on_rock, ground])
    normals = np.concatenate([rock_normals, np.tile([0.0, 0.0, 1.0], (len(ground), 1))])
    # The ground's texture is fine and even; what differs is the light on it.
    lit = shade.light(ground, np.tile([0.0, 0.0, 1.0], (len(ground), 1)))
    ground_contrast = 0.15 * lit / max(config.scene.ambient + config.scene.sun_irradiance, 1e-9)
    distances, neighbours = cKDTree(samples).query(samples, k=SAMPLE_NEIGHBOURS)
    return {
        "landmarks_m": landmarks,
        "landmark_normals": normals,
        "landmark_contrast": np.concatenate([shade.contrast(on_rock, rock_normals), ground_contrast]),
        "n_rock": np.array(len(on_rock)),
        "n_near": np.array(n_near),
        "samples_m": samples,
        "sample_normals": sample_normals,
        "sample_contrast": shade.contrast(samples, sample_normals),
        "observable": observable,
        "sample_neighbours": neighbours.astype(np.int32),
        "sample_distances_m": distances,
    }


def _near_m(config: MissionConfig) -> float:
    """How far near ground reaches from the target's axis: what photographs show does not end at a scorer's box."""
    return max(config.shared.box_half_extent_m, SharedTermsConfig().box_half_extent_m) + GROUND_MARGIN_M


def _near_ground(half_extent_m: float) -> Floats:
    """A jittered hexagonal lattice on z = 0 around the origin.

    Real ground features are random but several times denser; a lattice has their distances to
    neighbours, even the 95th percentile, with fewer points.
    """
    spacing_m = GROUND_SPACING_M
    rows = int(np.ceil(half_extent_m / (spacing_m * np.sqrt(3) / 2)))
    columns = int(np.ceil(half_extent_m / spacing_m)) + 1
    i, j = np.meshgrid(np.arange(-rows, rows + 1), np.arange(-columns, columns + 1), indexing="ij")
    xy = np.stack([(j + 0.5 * (i % 2)) * spacing_m, i * spacing_m * np.sqrt(3) / 2], axis=-1).reshape(-1, 2)
    xy = xy + keyed_rng("geometric-ground").normal(0.0, 0.2 * spacing_m, xy.shape)
    xy = xy[np.abs(xy).max(axis=1) <= half_extent_m]
    return np.column_stack([xy, np.zeros(len(xy))])


def _far_ground(inner_m: float) -> Floats:
    """Points on z = 0 outside the near square, equally many per doubling of the distance.

    Photographs resolve the ground in proportion to its distance, and sparse models thin out so.
    """
    u, bearing = keyed_rng("geometric-far-ground").random((FAR_LANDMARKS, 2)).T
    radius = inner_m * (FAR_RADIUS_M / inner_m) ** u
    xy = radius[:, None] * np.stack([np.cos(2 * np.pi * bearing), np.sin(2 * np.pi * bearing)], axis=1)
    xy = xy[np.abs(xy).max(axis=1) > inner_m]
    return np.column_stack([xy, np.zeros(len(xy))])


def _under_rock(caster: RayCaster, points_m: Floats) -> Bools:
    rays = rays_of(points_m - [0.0, 0.0, 1e-3], np.array([0.0, 0.0, 1.0]))
    rests: Bools = caster.cast(rays).t < 0.03  # the rock rests on it
    return rests


class _Shading:
    """Light on the surface and the contrast that a detector finds in it."""

    def __init__(self, rock: Rock, config: MissionConfig, caster: RayCaster) -> None:
        self._to_sun = direction_to_sun(config.scene)
        self._ambient, self._irradiance = config.scene.ambient, config.scene.sun_irradiance
        self._caster = caster
        normals = vertex_normals(rock.vertices_m, rock.faces)
        self._facing = np.maximum(normals @ self._to_sun, 0.0)
        self._grey = rock.albedo.mean(axis=1).astype(float)
        self._tree = cKDTree(rock.vertices_m)

    def in_sun(self, points_m: Floats, normals: Floats) -> Bools:
        """(N,) points that the rock does not shade."""
        return ~self._caster.blocked(rays_of(points_m + LIFT_M * normals, self._to_sun))

    def light(self, points_m: Floats, normals: Floats) -> Floats:
        """(N,) ambient light and sun."""
        sun = np.maximum(normals @ self._to_sun, 0.0) * self.in_sun(points_m, normals)
        return self._ambient + self._irradiance * sun

    def contrast(self, points_m: Floats, normals: Floats) -> Floats:
        """(N,) standard deviation of albedo times light among the nearby vertices."""
        distance, index = self._tree.query(points_m, k=TEXTURE_NEIGHBOURS)
        lit = self.in_sun(points_m, normals)[:, None]
        value = self._grey[index] * (self._ambient + self._irradiance * self._facing[index] * lit)
        # A coarse mesh has fewer vertices than this within reach: then the nearest few must do.
        weight = (distance <= np.maximum(TEXTURE_RADIUS_M, distance[:, 7:8])).astype(float)
        mean = (value * weight).sum(axis=1) / weight.sum(axis=1)
        return np.sqrt((weight * (value - mean[:, None]) ** 2).sum(axis=1) / weight.sum(axis=1))
