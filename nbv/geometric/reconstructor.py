"""A ``Reconstructor`` without images: simulated detections, tracks, and a predicted dense outcome."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from nbv.config import MissionConfig
from nbv.errors import MissionFailure
from nbv.geometric.completeness import sample_probability
from nbv.geometric.landmarks import Draw, FeatureModel, landmarks_of
from nbv.geometric.tracks import Tracks
from nbv.geometric.world import GeometricWorld
from nbv.geometry.stereo_chance import DenseModel
from nbv.types import Capture, Floats, PointCloud, SparseModel, UpdateReport

MIN_TRIANGULATION_ANGLE_DEG = 1.5  # COLMAP's default
# Landmarks that a seed shares with all others, pair by pair, where SIFT alone holds it. Rings of 12 and 14 seeds at 20
# degrees do not register, those of 16, 18 and 24 do (boulder, vesicular): 172 to 246 and from 272 on.
HELD_LANDMARKS = 258


@dataclass(frozen=True)
class _SeedState:
    """What bootstrapping leaves: the same for every configuration on one (rock, replicate)."""

    world: GeometricWorld
    tracks: Tracks
    registered: tuple[int, ...]
    centers_m: tuple[Floats, ...]  # of the registered cameras
    report: UpdateReport


_SEEDS: dict[tuple[object, ...], _SeedState] = {}
_MAX_SEEDS = 32


def forget_seed_models() -> None:
    """Remove all seed models from this process's memory."""
    _SEEDS.clear()


class GeometricReconstructor:
    """Implements ``nbv.types.Reconstructor`` on a `GeometricWorld`.

    Detections are drawn per (rock, replicate, viewpoint, landmark) and matching limits and noise per
    (rock, replicate, landmark): nothing depends on the order in which viewpoints are visited. The cameras
    are known exactly, so the alignment residual is 0.

    Of ``sparse.*`` only ``min_inliers``, ``min_registered_seeds``, ``max_pair_angle_deg`` and whether there are
    ``ground_features`` mean anything.

    Parameters
    ----------
    world
        Landmarks and surface samples of the rock, and what each viewpoint sees of them.
    config
        The mission's configuration.
    rock_sha256, replicate
        Key of all random draws.
    """

    def __init__(
        self,
        world: GeometricWorld,
        config: MissionConfig,
        rock_sha256: str,
        replicate: int,
    ) -> None:
        self._world, self._config = world, config
        self._rock_sha256, self._replicate = rock_sha256, replicate
        self._features = FeatureModel()
        # Far ground only matters to statistics over the whole cloud.
        self._n = len(world.landmarks_m) if config.stop.knn_region == "all" else world.n_near
        sparse = config.sparse
        self._identity: tuple[object, ...] = (
            rock_sha256,
            replicate,
            self._n,
            config.target_m,
            config.camera,
            sparse.min_inliers,
            sparse.min_registered_seeds,
            sparse.max_pair_angle_deg,
            sparse.ground_features > 0,
        )
        draw = Draw(
            self._n,
            self._features,
            sparse.max_pair_angle_deg,
            rock_sha256,
            replicate,
            sparse.ground_features > 0,
        )
        self._landmarks = landmarks_of(world, draw)
        self._tracks: Tracks | None = None
        self._rows: list[int] = []  # of the registered captures, in the world's tables
        self._captures: list[Capture] = []  # registered
        self._centers_m: list[Floats] = []  # theirs
        self._predicted: tuple[int, Floats] | None = None  # with the number of views that it is for

    # -- the sparse model ----------------------------------------------------------------------------

    def bootstrap(self, captures: Sequence[Capture]) -> UpdateReport:
        """The seed model; `MissionFailure` if too few seeds share landmarks."""
        key = (*self._identity, tuple((c.name, c.camera_from_world.tobytes()) for c in captures))
        seed = _SEEDS.get(key)
        if seed is None or seed.world is not self._world:
            seed = self._build_seed(captures)
            while len(_SEEDS) >= _MAX_SEEDS:
                _SEEDS.pop(next(iter(_SEEDS)))
            _SEEDS[key] = seed
        budget = self._config.adaptive_budget
        self._tracks = seed.tracks.copy(len(captures) + budget)
        self._captures = [captures[i] for i in seed.registered]
        self._centers_m = list(seed.centers_m)
        self._rows = [self._world.index(capture.viewpoint.id) for capture in self._captures]
        return seed.report

    def glimpse(self, captures: Sequence[Capture]) -> SparseModel | None:
        """None: the target is known here."""
        return None

    def _build_seed(self, captures: Sequence[Capture]) -> _SeedState:
        centers = [capture.camera_center_m for capture in captures]
        looks = [self._landmarks.look(c.viewpoint.id, center) for c, center in zip(captures, centers)]
        tracks = Tracks(self._landmarks.cosine_limit, len(captures))
        for look in looks:
            tracks.add(*look)
        # A seed takes part if it shares landmarks with the others, whichever came first.
        _, _, views = tracks.points(2)
        shared = np.bincount(views, minlength=len(captures))
        good = np.flatnonzero(shared >= self._config.sparse.min_inliers).tolist()
        held = (
            len(captures)
            if self._config.sparse.ground_features
            else int((tracks.shared().sum(axis=1) >= HELD_LANDMARKS).sum())
        )
        if held < self._config.sparse.min_registered_seeds:
            raise MissionFailure(
                "seed_model_failed",
                f"only {held} of {len(captures)} seeds are held together by what SIFT matches; fly them closer "
                "together, or set sparse.ground_features",
            )
        if len(good) < self._config.sparse.min_registered_seeds:
            raise MissionFailure(
                "seed_model_failed",
                f"{len(good)} of {len(captures)} seeds share {self._config.sparse.min_inliers} landmarks",
            )
        if len(good) < len(captures):
            tracks = Tracks(self._landmarks.cosine_limit, len(captures))
            for i in good:
                tracks.add(*looks[i])
        self._tracks = tracks
        self._captures = [captures[i] for i in good]
        self._centers_m = [centers[i] for i in good]
        report = UpdateReport(self._model(), True, f"{len(good)} of {len(captures)} seeds registered")
        return _SeedState(self._world, tracks, tuple(good), tuple(self._centers_m), report)

    def add(self, capture: Capture) -> UpdateReport:
        """One more view; unregistered if it shares too few landmarks with the earlier ones."""
        assert self._tracks is not None, "bootstrap comes first"
        center = capture.camera_center_m
        matches = self._tracks.add(*self._landmarks.look(capture.viewpoint.id, center))
        if matches < self._config.sparse.min_inliers:
            self._tracks.drop_last()
            return UpdateReport(self._model(), False, f"shares only {matches} landmarks")
        self._captures.append(capture)
        self._centers_m.append(center)
        self._rows.append(self._world.index(capture.viewpoint.id))
        return UpdateReport(self._model(), True)

    def _model(self) -> SparseModel:
        assert self._tracks is not None
        features, camera = self._features, self._config.camera
        landmark, offsets, views = self._tracks.points(features.min_track_length)
        centers = np.array(self._centers_m)
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
        good = half_angle * 2.0 >= np.deg2rad(MIN_TRIANGULATION_ANGLE_DEG)
        if not good.all():
            keep = np.repeat(good, lengths)
            landmark, mean, half_angle, views = landmark[good], mean[good], half_angle[good], views[keep]
            lengths = lengths[good]
            offsets = np.concatenate([[0], np.cumsum(lengths)]).astype(np.int64)
        # A pixel's error at the distance of the target; along the rays it grows as they close up.
        across = (
            features.noise_px / camera.focal_px * self._distance_m(centers) / np.sqrt(np.maximum(lengths, 1))
        )
        along = across / np.maximum(np.sin(half_angle), 0.02)
        noise = self._landmarks.noise[landmark]
        points = self._world.landmarks_m[landmark] + across[:, None] * noise
        points += ((along - across) * np.einsum("ij,ij->i", noise, mean))[:, None] * mean
        return SparseModel(
            points_m=points,
            reprojection_error_px=self._landmarks.error_px[landmark],
            track_offsets=offsets,
            track_cameras=views,
            camera_centers_m=centers,
            camera_names=tuple(capture.name for capture in self._captures),
            alignment_rms_m=0.0,
            alignment_max_m=0.0,
        )

    def _distance_m(self, centers_m: Floats) -> float:
        return float(np.linalg.norm(centers_m - np.array(self._config.target_m), axis=1).mean())

    # -- the dense outcome ---------------------------------------------------------------------------

    def predicted(self) -> Floats:
        """(S,) chance that each of the world's surface samples is reconstructed from the registered views."""
        if self._predicted is not None and self._predicted[0] == len(self._rows):
            return self._predicted[1]
        centers = np.array(self._centers_m).reshape(-1, 3)
        chance = sample_probability(self._world, self._rows, centers, self._config, DenseModel())
        self._predicted = (len(self._rows), chance)
        return chance

    def retarget(self, target_m: tuple[float, float, float], half_width_m: float) -> None:
        """Nothing: what each viewpoint sees is tabulated about the true target, which is known here."""

    def finish(self) -> PointCloud:
        """The surface samples that are more likely reconstructed than not."""
        likely = self.predicted() >= 0.5
        if not likely.any():
            raise MissionFailure("empty_dense_cloud", "no surface sample is likely to be reconstructed")
        return PointCloud(self._world.samples_m[likely], None, self._world.sample_normals[likely])
