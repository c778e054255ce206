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
import scipy
from numpy.typing import NDArray

from nbv.cache import Arrays, Recent, Store, cached
from nbv.config import CameraConfig, MissionConfig
from nbv.config.sections_planning import SharedTermsConfig
from nbv.evaluation.ground_truth import measured_faces, observable_mask
from nbv.geometry.mesh import RayCaster, rays_of, sample_surface, vertex_normals
from nbv.geometry.visibility import (
    LANDMARK_MAX_INCIDENCE_DEG,
    OBSERVABLE_MAX_INCIDENCE_DEG,
    in_frustum,
    seen_from,
)
from nbv.process import keyed_rng
from nbv.rocks import Rock
from nbv.rocks.families import generated_name
from nbv.scene.bake import direction_to_sun
from nbv.types import Bools, Floats, Floats32, Ints, Point, Viewpoint
from nbv.viewpoints import camera_shell

# The simulator's landmarks: how easily each is detected and matched, and which of them a view detects.
#
# Everything is drawn per (rock, replicate) and per (rock, replicate, viewpoint), so it is the same in every mission on
# them. The constants were set to reproduce real seed models (docs/results/index.md).


ROCK_RATE = 0.7  # share of views in which a strong, well-lit landmark is detected
GROUND_RATE = 0.9
HALF_CONTRAST = 0.012  # at this local contrast it is half of that
# With 60 px of focal length neither these nor photogrammetric missions of slab have a seed model; with 120, 200 and 300 px these
# score 88, 91 and 95, those 74, 84 and 92 (F-score at 48 mm, 24 + 8 photographs).
RESOLVED = 0.4
MAX_INCIDENCE_DEG = 75.0
FAR_MAX_INCIDENCE_DEG = 86.0  # flat ground far away is only ever seen at a grazing angle
ROCK_MATCH_DEG = (12.0, 45.0)  # lines of sight that match: drawn per landmark
GROUND_MATCH_DEG = (15.0, 125.0)  # flat, so it looks alike from farther


class Landmarks:
    """The draws of one (rock, replicate) for a world's landmarks, L of them, and what its viewpoints detect.

    Of the configuration, far ground only matters where ``stop.knn_region`` is of all of the cloud; ground features let the ground
    look alike from everywhere.
    """

    def __init__(
        self, world: GeometricWorld, config: MissionConfig, rock_sha256: str, replicate: int
    ) -> None:
        self._world, self._key = world, (rock_sha256, replicate)
        self.count = n = len(world.landmarks_m) if config.stop.knn_region == "all" else world.n_near
        # Row by row, so a landmark's draw does not depend on n.
        strength, reach = keyed_rng("geometric-landmarks", *self._key).random((n, 2)).T
        noise = keyed_rng("geometric-noise", *self._key).standard_normal((n, 4))
        on_rock = np.arange(n) < world.n_rock
        # The ground's landmarks are a thinned lattice of its strongest features: all are worth something.
        rate = np.minimum(np.where(on_rock, ROCK_RATE * 2.0 * strength, GROUND_RATE), 1.0)
        contrast = world.landmark_contrast[:n]
        low, high = (np.where(on_rock, *both) for both in zip(ROCK_MATCH_DEG, GROUND_MATCH_DEG))
        limit_deg = low + (high - low) * reach**2
        if config.sparse.ground_features:
            limit_deg = np.where(on_rock, limit_deg, 180.0)
        limit_deg = np.minimum(limit_deg, config.sparse.max_pair_angle_deg)
        far = np.arange(n) >= world.n_near
        # (L,) chance of a detection face on, and the cosine of the incidence beyond which nothing is detected.
        self._quality = rate * contrast / (contrast + HALF_CONTRAST)
        self._grazing = np.cos(np.deg2rad(np.where(far, FAR_MAX_INCIDENCE_DEG, MAX_INCIDENCE_DEG)))
        # (L,) the cosine of the angle between two lines of sight that still match.
        self.cosine_limit: Floats = np.cos(np.deg2rad(limit_deg))
        self.noise: Floats = noise[:, :3]  # (L, 3) of the point's position, standard normal
        self.error_px: Floats = 0.28 * np.exp(0.8 * noise[:, 3])  # (L,) reprojection error

    def detected_from(self, view: Viewpoint, aim_m: Point, center_m: Floats) -> tuple[Ints, Floats32]:
        """Indices (K,) of the landmarks that a photograph detects, and unit directions (K, 3) from them to the camera.

        ``aim_m``: where the camera is aimed; ``center_m`` (3,): where it really is, arrival error included.
        """
        world = self._world
        seen = np.flatnonzero(world.landmarks_seen(view.position_m, aim_m)[: self.count])
        directions = center_m - world.landmarks_m[seen]
        directions /= np.sqrt(np.einsum("ij,ij->i", directions, directions))[:, None]
        cosine = np.einsum("ij,ij->i", directions, world.landmark_normals[seen])
        grazing = self._grazing[seen]
        chance = self._quality[seen] * np.clip((cosine - grazing) / (1.0 - grazing), 0.0, 1.0)
        chance = resolved(chance, world.camera, RESOLVED)
        rng = keyed_rng("geometric-detection", *self._key, view.id)
        detected = rng.random(self.count)[seen] < chance
        return seen[detected], directions[detected].astype(np.float32)


# Feature tracks without images: which views' detections of a landmark end up in one sparse point.
#
# Detections of one landmark in two views match when their lines of sight differ little enough; a track is a
# connected set of matching detections, as in COLMAP. A landmark may have several tracks (seen from opposite
# sides, say), and each is a point of its new.


class Tracks:
    """Detections and their grouping, view by view; L landmarks, at most ``capacity`` views.

    ``cosine_limit`` (L,) is the smallest cosine between two lines of sight that still match, per landmark.
    """

    def __init__(self, cosine_limit: Floats | Floats32, capacity: int) -> None:
        self._cosine_limit = cosine_limit.astype(np.float32)
        self.n_views = 0
        self._directions = np.zeros((capacity, len(cosine_limit), 3), dtype=np.float32)
        # The number of a view in the track, or -1: which one is arbitrary, equal numbers are one track.
        # A row per landmark, since tracks are listed landmark by landmark.
        self._labels = np.full((len(cosine_limit), capacity), -1, dtype=np.int16)

    def copy(self, capacity: int) -> Tracks:
        """The same tracks with room for ``capacity`` views."""
        other = Tracks(self._cosine_limit, capacity)
        other.n_views = n = self.n_views
        other._directions[:n] = self._directions[:n]
        other._labels[:, :n] = self._labels[:, :n]
        return other

    def add(self, landmarks: Ints, directions: NDArray[np.floating], needed: int = 0) -> int:
        """Add a view: the landmarks (K,) that it detects, and unit directions (K, 3) from them to the camera.

        Returns its matches, detections that match an earlier one. A view with fewer than ``needed`` is not added.
        """
        m, capacity = self.n_views, self._labels.shape[1]
        here = directions.astype(np.float32, copy=False)
        # All earlier detections of these landmarks: which of the new ones (0 to K - 1), in which view, in which track.
        before = self._labels.take(landmarks, axis=0).ravel()
        index = np.flatnonzero(before >= 0)
        new = index // capacity
        view = index - new * capacity
        track = before[index].astype(np.int64)
        cosine = np.einsum("ij,ij->i", self.directions_of(view, landmarks[new]), here.take(new, axis=0))
        linked = cosine >= self._cosine_limit[landmarks][new]
        joined = np.zeros((m + 1, len(landmarks)), dtype=bool)  # [track, new detection]; row m stays False
        joined[track[linked], new[linked]] = True
        matches = int(joined.any(axis=0).sum())
        if matches < needed:
            return matches
        self.n_views = m + 1
        self._directions[m, landmarks] = here
        label = np.where(joined.any(axis=0), joined.argmax(axis=0), m)
        # Where this view joins several tracks, they become one.
        merged = joined[track, new]
        self._labels[landmarks[new[merged]], view[merged]] = label[new[merged]]
        self._labels[landmarks, m] = label
        return matches

    def shared(self) -> Ints:
        """(V, V) landmarks that two views detect and match with each other directly."""
        counts = np.zeros((self.n_views, self.n_views), dtype=np.int64)
        detected = self._labels[:, : self.n_views] >= 0
        for a in range(self.n_views):
            for b in range(a):
                both = np.flatnonzero(detected[:, a] & detected[:, b])
                cosine = np.einsum("ij,ij->i", self._directions[a, both], self._directions[b, both])
                counts[a, b] = counts[b, a] = np.count_nonzero(cosine >= self._cosine_limit[both])
        return counts

    def directions_of(self, views: Ints, landmarks: Ints) -> Floats32:
        """(T, 3) directions from landmarks to cameras, ``directions[views, landmarks]`` in a third of the time."""
        flat = self._directions.reshape(-1, 3)
        return flat.take(views * self._directions.shape[1] + landmarks, axis=0)

    def points(self, min_views: int) -> tuple[Ints, Ints, Ints]:
        """Tracks of at least ``min_views`` views: their landmarks (P,), offsets (P + 1,), views (T,) (CSR)."""
        count, capacity = self._labels.shape
        # Small integers sort and divide several times faster, np.floor_divide faster than np.divmod.
        small = np.int32 if count * capacity * capacity <= np.iinfo(np.int32).max else np.int64
        labels = self._labels.ravel()
        index: Ints = np.flatnonzero(labels >= 0)
        label = labels.take(index)
        index = index.astype(small)
        view = index % capacity
        key = (index - view + label) * capacity + view
        # By landmark, track, view. Most landmarks have one track, so nearly in order: a merge sort is fast on that.
        key.sort(kind="stable")
        track = key // capacity
        view = key - track * capacity
        first = np.flatnonzero(np.concatenate([[True], track[1:] != track[:-1]])) if len(key) else key
        length = np.diff(np.append(first, len(key)))
        long = length >= min_views
        keep = np.repeat(long, length)
        offsets = np.concatenate([[0], np.cumsum(length[long])]).astype(np.int64)
        return (track[first[long]] // capacity).astype(np.int64), offsets, view[keep].astype(np.int64)


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
    up = rays_of(ground - [0.0, 0.0, 1e-3], np.array([0.0, 0.0, 1.0]))
    ground = ground[caster.cast(up).t >= 0.03]  # else the rock rests on it
    n_near = len(on_rock) + int((np.abs(ground[:, :2]).max(axis=1) <= near_m).sum())
    landmarks = np.concatenate([on_rock, ground])
    normals = np.concatenate([rock_normals, np.tile([0.0, 0.0, 1.0], (len(ground), 1))])
    # The ground's texture is fine and even; what differs is the light on it.
    lit = shade.light(ground, np.tile([0.0, 0.0, 1.0], (len(ground), 1)))
    ground_contrast = 0.15 * lit / max(config.scene.ambient + config.scene.sun_irradiance, 1e-9)
    distances, neighbours = scipy.spatial.cKDTree(samples).query(samples, k=SAMPLE_NEIGHBOURS)
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


class _Shading:
    """Light on the surface and the contrast that a detector finds in it."""

    def __init__(self, rock: Rock, config: MissionConfig, caster: RayCaster) -> None:
        self._to_sun = direction_to_sun(config.scene)
        self._ambient, self._irradiance = config.scene.ambient, config.scene.sun_irradiance
        self._caster = caster
        normals = vertex_normals(rock.vertices_m, rock.faces)
        self._facing = np.maximum(normals @ self._to_sun, 0.0)
        self._grey = rock.albedo.mean(axis=1).astype(float)
        self._tree = scipy.spatial.cKDTree(rock.vertices_m)

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
