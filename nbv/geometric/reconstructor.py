"""A ``Reconstructor`` without images: simulated detections, tracks, and a predicted dense outcome."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from nbv.config import MissionConfig
from nbv.errors import MissionFailure
from nbv.geometric.completeness import coarse_depth, sample_probability
from nbv.geometric.world import GeometricWorld, Landmarks, Tracks
from nbv.geometry.frames import camera_centers_m
from nbv.process import keyed_rng
from nbv.types import (
    Bools,
    Capture,
    Floats,
    Floats32,
    Ints,
    Point,
    PointCloud,
    Reconstructor,
    SparseModel,
    UpdateReport,
)

MIN_TRIANGULATION_ANGLE_DEG = 1.5  # COLMAP's default
# Landmarks that a seed shares with all others, pair by pair, where SIFT alone holds it. Too many for even orbits: of 16 seeds at
# 20 degrees 8 and 11 are held on boulder (two replicates), 6 on stack and 10 on bowl, of 20 at 15 degrees 5 on boulder, 7 on
# vesicular and none on stack; photogrammetry registers all of each (docs/results/index.md).
HELD_LANDMARKS = 258


MIN_TRACK_LENGTH = 3
NOISE_PX = 0.5
DEPTH_NOISE_M = 0.01  # of depth at a quarter of the pixels


class GeometricReconstructor(Reconstructor):
    """Simulated, on a `GeometricWorld`; photographs are aimed at ``aim_m`` (3,).

    Detections are drawn per (rock, replicate, viewpoint, landmark) and matching limits and noise per
    (rock, replicate, landmark): nothing depends on the order in which viewpoints are visited. The cameras
    are known exactly, so the alignment residual is 0.

    A photograph registers if it matches ``sparse.min_inliers`` landmarks of the model; those that did not are tried again after
    every update. A view has a hundred of the landmarks that stand for thousands of features: to ask for points, as COLMAP does,
    is too much, since rendered photographs of such plans register.
    """

    def __init__(
        self,
        world: GeometricWorld,
        config: MissionConfig,
        aim_m: Point,
        rock_sha256: str,
        replicate: int,
    ) -> None:
        self._world, self._config, self._aim_m = world, config, aim_m
        self._landmarks = Landmarks(world, config, rock_sha256, replicate)
        # With the seeds' poses, all that a seed model depends on.
        self._identity = (
            rock_sha256,
            replicate,
            self._landmarks.count,
            config.target_m,
            config.camera,
            config.scene,
            config.sparse,
            self._draws_depth,
            config.dense,
        )
        self._tracks: Tracks | None = None
        self._captures: list[Capture] = []  # registered
        self._waiting: list[Capture] = []  # tried again after every photograph that is

    @property
    def _draws_depth(self) -> bool:
        return self._config.plans_on_depth

    def bootstrap(self, captures: Sequence[Capture]) -> UpdateReport:
        """The seed model; `MissionFailure` if too few seeds register."""
        key = (*self._identity, *((c.name, c.camera_from_world.tobytes()) for c in captures))
        tracks, joined, waiting, report = self._world.seed_models.get(key, lambda: self._build_seed(captures))
        self._tracks = tracks.copy(len(captures) + self._config.planned_views)
        self._captures, self._waiting = list(joined), list(waiting)
        return report

    def _detect(self, capture: Capture) -> tuple[Ints, Floats32]:
        center_m = camera_centers_m(capture.camera_from_world)
        return self._landmarks.detected_from(capture.viewpoint, self._aim_m, center_m)

    def _build_seed(
        self, captures: Sequence[Capture]
    ) -> tuple[Tracks, list[Capture], list[Capture], UpdateReport]:
        """Tracks, the seeds that register, those that do not, and the model: the same for every configuration with these seeds."""
        sparse = self._config.sparse
        every = self._every_track(captures)
        held = len(captures)
        if not sparse.ground_features:
            held = int((every.shared().sum(axis=1) >= HELD_LANDMARKS).sum())
        if held < sparse.min_registered_seeds:
            raise MissionFailure(
                "seed_model_failed",
                f"only {held} of {len(captures)} seeds are held together by what SIFT matches; take them closer "
                "together, or set sparse.ground_features",
            )
        # A seed takes part if it shares landmarks with the others, whichever came first.
        _, _, views = every.points(2)
        shared = np.bincount(views, minlength=len(captures))
        joined = [capture for capture, n in zip(captures, shared, strict=True) if n >= sparse.min_inliers]
        if len(joined) < sparse.min_registered_seeds:
            raise MissionFailure(
                "seed_model_failed",
                f"{len(joined)} of {len(captures)} seeds share {sparse.min_inliers} landmarks",
            )
        names = {capture.name for capture in joined}
        self._captures = [capture for capture in captures if capture.name in names]
        self._waiting = [capture for capture in captures if capture.name not in names]
        self._tracks = self._every_track(self._captures) if self._waiting else every
        report = UpdateReport(self._model(), True, f"{len(joined)} of {len(captures)} seeds registered")
        return self._tracks, self._captures, self._waiting, report

    def _every_track(self, captures: Sequence[Capture]) -> Tracks:
        """Of photographs in this order, whichever match."""
        tracks = Tracks(self._landmarks.cosine_limit, len(captures))
        for capture in captures:
            tracks.add(*self._detect(capture))
        return tracks

    def add(self, capture: Capture) -> UpdateReport:
        """One more view, and another try for those that are out: whichever match too few landmarks of the model."""
        assert self._tracks is not None, "bootstrap comes first"
        joined, waiting, progress = list[Capture](), [capture, *self._waiting], True
        needed = self._config.sparse.min_inliers
        while progress:  # each that registers opens the way for others
            progress = False
            for other in tuple(waiting):
                if self._tracks.add(*self._detect(other), needed) >= needed:
                    joined.append(other)
                    waiting = [c for c in waiting if c is not other]
                    progress = True
        self._waiting = waiting
        self._captures += joined
        registered = any(c is capture for c in joined)
        late = [c.name for c in joined if c is not capture]
        notes = [] if registered else [f"matches fewer than {self._config.sparse.min_inliers} points"]
        notes += [f"now registered too: {', '.join(late)}"] if late else []
        return UpdateReport(self._model(), registered, "; ".join(notes))

    def _centers_m(self) -> Floats:
        """(V, 3) of the registered cameras."""
        return np.array([camera_centers_m(capture.camera_from_world) for capture in self._captures]).reshape(
            -1, 3
        )

    def _model(self) -> SparseModel:
        """Return the sparse model of the registered captures: tracks, and points with noise that falls with their rays' angle."""
        assert self._tracks is not None
        landmark, offsets, views = self._tracks.points(MIN_TRACK_LENGTH)
        centers = self._centers_m()
        lengths = np.diff(offsets)
        # Spread of the rays around their mean: half the widest angle, about.
        point = np.repeat(np.arange(len(landmark)), lengths)
        mean, half_angle = np.zeros((0, 3)), np.zeros(0)
        if len(landmark):
            rays = self._tracks.directions_of(views, landmark[point]).T.astype(float, order="C")  # (3, T)
            axis = np.add.reduceat(rays, offsets[:-1], axis=1)
            axis /= np.sqrt(np.einsum("ij,ij->j", axis, axis))
            nearest = np.minimum.reduceat(np.einsum("ij,ij->j", rays, axis.take(point, axis=1)), offsets[:-1])
            mean, half_angle = axis.T, np.arccos(np.clip(nearest, -1.0, 1.0))
        # A pixel's error at the distance of the target; along the rays it grows as they close up.
        distance_m = float(np.linalg.norm(centers - np.array(self._config.target_m), axis=1).mean())
        across = NOISE_PX / self._config.camera.focal_px * distance_m / np.sqrt(np.maximum(lengths, 1))
        along = across / np.maximum(np.sin(half_angle), 0.02)
        noise = self._landmarks.noise[landmark]
        points = self._world.landmarks_m[landmark] + across[:, None] * noise
        points += ((along - across) * np.einsum("ij,ij->i", noise, mean))[:, None] * mean
        model = SparseModel(
            points_m=points,
            reprojection_error_px=self._landmarks.error_px[landmark],
            track_offsets=offsets,
            track_cameras=views,
            camera_centers_m=centers,
            camera_names=tuple(capture.name for capture in self._captures),
            alignment_rms_m=0.0,
            alignment_max_m=0.0,
        )
        model = model.select(np.flatnonzero(half_angle * 2.0 >= np.deg2rad(MIN_TRIANGULATION_ANGLE_DEG)))
        if not self._draws_depth:
            return model
        rng = keyed_rng("geometric-depth", *self._identity[:2])
        n_samples = len(self._world.samples_m)
        depth_m, cameras = coarse_depth(
            self._world, self._seen(), centers, self._config, rng.random(n_samples)
        )
        depth_m = depth_m + DEPTH_NOISE_M * rng.standard_normal(depth_m.shape)
        return replace(model, depth_m=depth_m, depth_cameras=cameras)

    def predicted(self) -> Floats:
        """(S,) chance that each of the world's surface samples is reconstructed from the registered views."""
        return sample_probability(self._world, self._seen(), self._centers_m(), self._config)

    def _seen(self) -> Bools:
        views = (capture.viewpoint.position_m for capture in self._captures)
        return np.array([self._world.samples_seen(position_m, self._aim_m) for position_m in views])

    def finish(self) -> PointCloud:
        """The surface samples that are more likely reconstructed than not."""
        likely = self.predicted() >= 0.5
        if not likely.any():
            raise MissionFailure("empty_dense_cloud", "no surface sample is likely to be reconstructed")
        return PointCloud(self._world.samples_m[likely], None, self._world.sample_normals[likely])
