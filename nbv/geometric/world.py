"""What the geometric fidelity knows of a rock: landmarks, surface samples, and who can see them.

Computed once per rock and set of viewpoints (seconds of ray casting) and kept in the store. Visibility is
resolved at the viewpoints' nominal positions: an arrival error of some 12 cm at 3.5 m moves an outline by
a centimetre or two. Angles and incidences use the actual positions (`nbv.geometric.reconstructor`).
A buried rock is what is above ground; neighbours hide and shade, but have no landmarks; relief is flat here.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from nbv.cache import Arrays, Store, remember
from nbv.config import MissionConfig, SeedConfig
from nbv.evaluation.ground_truth import MIN_OBSERVING_VIEWS
from nbv.geometry.frustum import in_frustum
from nbv.geometry.raycasting import RayCaster, rays_of
from nbv.geometry.sampling import sample_surface
from nbv.geometry.visibility import (
    LANDMARK_MAX_INCIDENCE_DEG,
    OBSERVABLE_MAX_INCIDENCE_DEG,
    lifted,
    seen_from,
)
from nbv.random_streams import keyed_rng
from nbv.rocks import Rock
from nbv.rocks.mesh import vertex_normals
from nbv.terrain import Body, Surroundings, make_surroundings
from nbv.types import Bools, Floats, Viewpoint
from nbv.viewpoints import raw_candidates, seed_viewpoints, shell_viewpoints

SURFACE_SAMPLES = 3_000
ROCK_LANDMARKS = 1_800  # candidates on the rock; most are too faint to be detected often
GROUND_MARGIN_M = 0.05  # near ground reaches this far beyond the planners' box
GROUND_SPACING_M = 0.118
FAR_LANDMARKS = 1_000
FAR_RADIUS_M = 30.0
TEXTURE_RADIUS_M = 0.03  # a feature's neighbourhood
TEXTURE_NEIGHBOURS = 48
SAMPLE_NEIGHBOURS = 16
LIFT_M = 1e-3  # of a ray off the facet that it starts from; with it the model was calibrated


@dataclass(frozen=True)
class GeometricWorld:
    """Arrays of one rock; V viewpoints, L landmarks, S surface samples.

    Landmarks are sorted: rock, near ground, far ground (the last only matters to statistics over the
    whole sparse cloud).
    """

    viewpoint_ids: tuple[str, ...]  # (V,)
    landmarks_m: Floats  # (L, 3)
    landmark_normals: Floats  # (L, 3)
    landmark_contrast: Floats  # (L,) local standard deviation of the shaded albedo, 0 to 1
    landmark_seen: Bools  # (V, L) inside the image, front side, not hidden
    n_rock: int
    n_near: int  # rock and near ground
    samples_m: Floats  # (S, 3) of the whole surface, uniform by area
    sample_normals: Floats  # (S, 3)
    sample_contrast: Floats  # (S,)
    sample_seen: Bools  # (V, S)
    observable: Bools  # (S,) what `nbv.evaluation` counts as observable
    sample_neighbours: NDArray[np.int32]  # (S, K) nearest samples, the sample itself first
    sample_distances_m: Floats  # (S, K)

    def index(self, viewpoint_id: str) -> int:
        """Row of a viewpoint in the visibility tables."""
        return self._rows[viewpoint_id]

    def reach_counts(self, t_m: float) -> NDArray[np.intp]:
        """(S,) how many of each sample's listed neighbours, itself included, are nearer than ``t_m``."""
        if t_m not in self._reach_counts:
            self._reach_counts[t_m] = (self.sample_distances_m < t_m).sum(axis=1)
        return self._reach_counts[t_m]

    @cached_property
    def _reach_counts(self) -> dict[float, NDArray[np.intp]]:
        return {}

    @cached_property
    def neighbours_by_rank(self) -> NDArray[np.intp]:
        """(K, S) `sample_neighbours`: every sample's nearest (itself), every sample's second nearest, ..."""
        return np.ascontiguousarray(self.sample_neighbours.T, dtype=np.intp)

    @cached_property
    def _rows(self) -> dict[str, int]:
        return {name: row for row, name in enumerate(self.viewpoint_ids)}


_WORLDS: dict[tuple[object, ...], GeometricWorld] = {}
_MAX_WORLDS = 16


def world_of(rock: Rock, config: MissionConfig, store: Store | None) -> GeometricWorld:
    """The rock's world; from memory, since a campaign in one process comes back to it, from the store, or made."""
    # All that is read here of the configuration, and a little more.
    key = (
        rock.sha256,
        config.camera,
        config.scene,
        config.ground,
        config.seed,
        config.pool,
        config.target_m,
        config.shared.box_half_extent_m,
    )
    world = _WORLDS.pop(key, None) or load_world(rock, config, store)
    while len(_WORLDS) >= _MAX_WORLDS:
        _WORLDS.pop(next(iter(_WORLDS)))
    _WORLDS[key] = world  # most recently used last
    return world


def forget_worlds() -> None:
    """Remove all worlds from this process's memory."""
    _WORLDS.clear()


def load_world(rock: Rock, config: MissionConfig, store: Store | None = None) -> GeometricWorld:
    """The world from the store, or a fresh one that is put there."""
    scene = config.scene
    inputs = [
        rock.sha256,
        config.camera,
        list(config.target_m),
        config.shared.box_half_extent_m,
        [list(scene.sun_travel), scene.sun_irradiance, scene.ambient],
        [[v.id, *v.position_m] for v in shell_viewpoints(config)],
    ]
    if (around := _neighbours(rock, config, store)) is not None:
        inputs.append(list(around.key))
    papers = replace(config, seed=SeedConfig())
    if config.seed.second_turn or seed_viewpoints(config) != seed_viewpoints(papers):
        return with_seeds(load_world(rock, papers, store), rock, config, around)
    names = [f.name for f in fields(GeometricWorld)]

    def build() -> Arrays:
        world = build_world(rock, config, around)
        return {name: np.asarray(getattr(world, name)) for name in names}

    arrays = remember(store, "geometric-worlds", build, code=__name__, inputs=inputs)
    plain: dict[str, Any] = {name: int(arrays[name]) for name in ("n_rock", "n_near")}
    plain["viewpoint_ids"] = tuple(arrays["viewpoint_ids"].tolist())
    return GeometricWorld(**{**arrays, **plain})


def with_seeds(
    world: GeometricWorld, rock: Rock, config: MissionConfig, around: Surroundings | None = None
) -> GeometricWorld:
    """``world`` with the seeds of ``config`` in place of the paper's; what counts as observable stays.

    Parameters
    ----------
    world
        Of the paper's seeds.
    rock, around
        What it was made of.
    config
        Its ``seed``, camera and target.
    """
    caster = _caster(rock, around)
    seeds = seed_viewpoints(config) + (
        seed_viewpoints(config, second_turn=True) if config.seed.second_turn else []
    )
    pool = np.array([not name.startswith("seed") for name in world.viewpoint_ids])

    def seen(points_m: Floats, normals: Floats, max_incidence_deg: float, known: Bools) -> Bools:
        return np.concatenate(
            [_seen(caster, points_m, normals, seeds, config, max_incidence_deg), known[pool]]
        )

    return replace(
        world,
        viewpoint_ids=(*(v.id for v in seeds), *(v.id for v in raw_candidates(config))),
        landmark_seen=seen(
            world.landmarks_m, world.landmark_normals, LANDMARK_MAX_INCIDENCE_DEG, world.landmark_seen
        ),
        sample_seen=seen(
            world.samples_m, world.sample_normals, OBSERVABLE_MAX_INCIDENCE_DEG, world.sample_seen
        ),
    )


def build_world(rock: Rock, config: MissionConfig, around: Surroundings | None = None) -> GeometricWorld:
    """Landmarks, samples and visibility of one rock, by ray casting on its mesh and its neighbours'."""
    caster = _caster(rock, around)
    viewpoints = shell_viewpoints(config)
    shade = _Shading(rock, config, caster)

    samples, sample_normals = sample_surface(rock.vertices_m, rock.faces, SURFACE_SAMPLES, 0)
    sample_seen = _seen(caster, samples, sample_normals, viewpoints, config, OBSERVABLE_MAX_INCIDENCE_DEG)
    observable = sample_seen.sum(axis=0) >= MIN_OBSERVING_VIEWS

    on_rock, rock_normals = sample_surface(rock.vertices_m, rock.faces, ROCK_LANDMARKS, 1)
    above = on_rock[:, 2] > 0
    on_rock, rock_normals = on_rock[above], rock_normals[above]
    near_m = config.shared.box_half_extent_m + GROUND_MARGIN_M
    near, far = _near_ground(near_m), _far_ground(near_m)
    ground = np.concatenate([near, far])
    ground = ground[
        ~_under_rock(caster, ground, open_below=config.ground.burial_m > 0 or config.ground.relief_m > 0)
    ]
    n_near = len(on_rock) + int((np.abs(ground[:, :2]).max(axis=1) <= near_m).sum())
    landmarks = np.concatenate([on_rock, ground])
    normals = np.concatenate([rock_normals, np.tile([0.0, 0.0, 1.0], (len(ground), 1))])
    # The ground's texture is fine and even; what differs is the light on it.
    lit = shade.light(ground, np.tile([0.0, 0.0, 1.0], (len(ground), 1)))
    ground_contrast = 0.15 * lit / max(config.scene.ambient + config.scene.sun_irradiance, 1e-9)
    distances, neighbours = cKDTree(samples).query(samples, k=SAMPLE_NEIGHBOURS)
    return GeometricWorld(
        viewpoint_ids=tuple(v.id for v in viewpoints),
        landmarks_m=landmarks,
        landmark_normals=normals,
        landmark_contrast=np.concatenate([shade.contrast(on_rock, rock_normals), ground_contrast]),
        landmark_seen=_seen(caster, landmarks, normals, viewpoints, config, LANDMARK_MAX_INCIDENCE_DEG),
        n_rock=len(on_rock),
        n_near=n_near,
        samples_m=samples,
        sample_normals=sample_normals,
        sample_contrast=shade.contrast(samples, sample_normals),
        sample_seen=sample_seen,
        observable=observable,
        sample_neighbours=neighbours.astype(np.int32),
        sample_distances_m=distances,
    )


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


def _neighbours(rock: Rock, config: MissionConfig, store: Store | None) -> Surroundings | None:
    if config.ground.neighbours == 0:
        return None
    return make_surroundings(config.ground, config.scene.ground_seed, rock.sha256, store)


def _caster(rock: Rock, around: Surroundings | None) -> RayCaster:
    parts: list[Rock | Body] = [rock, *(() if around is None else around.neighbours)]
    first = np.cumsum([0, *(len(part.vertices_m) for part in parts)])
    faces = [part.faces + n for part, n in zip(parts, first)]
    return RayCaster(np.concatenate([part.vertices_m for part in parts]), np.concatenate(faces))


def _under_rock(caster: RayCaster, points_m: Floats, *, open_below: bool) -> Bools:
    up = np.array([0.0, 0.0, 1.0])
    rays = rays_of(points_m - [0.0, 0.0, 1e-3], up)
    rests: Bools = caster.cast(rays).t < 0.03  # the rock rests on it
    if open_below:  # cut off at the ground, so a ray from below has gone in without a crossing
        rests |= caster.crossings(rays) % 2 == 1
    return rests


def _seen(
    caster: RayCaster,
    points_m: Floats,
    normals: Floats,
    viewpoints: list[Viewpoint],
    config: MissionConfig,
    max_incidence_deg: float,
) -> Bools:
    """(V, N) points in the image of each nominal view, facing it, above ground and not hidden by the rock."""
    centers = np.array([v.position_m for v in viewpoints])
    seen = in_frustum(points_m, centers, np.array(config.target_m), config.camera).T
    seen &= points_m[:, 2] >= 0
    starts = lifted(points_m, normals, LIFT_M)
    for row, center in enumerate(centers):
        ask = np.flatnonzero(seen[row])
        seen[row, ask] = seen_from(center, starts[ask], normals[ask], caster, max_incidence_deg)
    return seen


class _Shading:
    """Light on the surface and the contrast that a detector finds in it."""

    def __init__(self, rock: Rock, config: MissionConfig, caster: RayCaster) -> None:
        sun = np.array(config.scene.sun_travel)
        self._to_sun = -sun / np.linalg.norm(sun)
        self._ambient, self._irradiance = config.scene.ambient, config.scene.sun_irradiance
        self._caster = caster
        normals = vertex_normals(rock.vertices_m, rock.faces)
        self._facing = np.maximum(normals @ self._to_sun, 0.0)
        self._grey = rock.albedo.mean(axis=1).astype(float)
        self._tree = cKDTree(rock.vertices_m)

    def in_sun(self, points_m: Floats, normals: Floats) -> Bools:
        """(N,) points that the rock does not shade."""
        return ~self._caster.blocked(rays_of(lifted(points_m, normals, LIFT_M), self._to_sun))

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
