"""What the dense cloud will cover: a prediction from the sparse model alone.

The surface is estimated as the convex hull of the sparse points on the rock and of a smaller ball about
the target, so that what no photograph has matched yet exists on it, too. On it the rules of dense stereo
(`nbv.geometry.stereo_chance`) say what the registered views will reconstruct. Holes are expected where this
chance is least: the first feature is the least chance of the best nine tenths. They also occur where the hull is not the
surface: over a shape that is open from above, like a bucket, the hull is a lid without any point. So the third feature, beside
the rock's height, is the share of the top without a point, after lines of sight have carved what cameras look through. A logistic curve of the three gives a lower
quartile: three in four states of simulated missions on training rocks and shapes, to which it was fitted, are at least as
complete (``python -m research.predict_completeness fit``; docs/results/predicted_completeness.md).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.spatial import ConvexHull, cKDTree

from nbv.config import MissionConfig
from nbv.geometry.carving import Solid, carved, carved_top
from nbv.geometry.matchability import usable_cosines
from nbv.geometry.stereo_chance import ANGLE_DECAY_PER_DEG, good_view, reconstruction_probability
from nbv.geometry.visibility import OBSERVABLE_MAX_INCIDENCE_DEG, in_frustum
from nbv.random_streams import keyed_rng
from nbv.scorers.surface import FEWEST_POINTS, GROUND_CLEARANCE_M, ball, points_on_rock, sample_hull
from nbv.types import Bools, Floats, Floats32, SparseModel
from nbv.viewpoints import camera_shell

SAMPLES = 600
CARVED_SAMPLES = 600
FINE_CELLS = 28  # of the height of a surface that can hide itself
MOST_KNOWN, MOST_LINES = 60_000, 60_000  # places with depth, and lines of sight, that it is made from
# A cube is solid for certain with so many places, and so many for each line of sight that crosses it: one depth in twenty is wrong.
FEWEST_PLACES, PLACES_PER_LINE = 3, 0.3
BALL_WITHIN = 0.75  # of the ball about the target, where there are points enough
CONTRAST = 0.02  # of the rock's texture, which nothing says: the median of the training rocks
# On a carved surface, where views are chosen and no completeness is said: fitted to orbits of 12 to 24 photographs of four training
# rocks in `indoors`, whose noise costs wide pairs most (docs/results/where_planning_pays.md).
CAREFUL_CONTRAST, CAREFUL_DECAY_PER_DEG = 0.009, 0.02
FEWEST_OBSERVING = 2
WEAKEST = 0.1
BARE_BEYOND = 0.2  # of the height: this far from all points the top is bare
LEAST_BARE = 0.01  # is added to the bare share where its logarithm is taken
MOST_MISSING = 0.98  # of what will be missing decides; the many samples of the rest take time
LEAST_CHANCE = 0.05  # what has less is not covered at all: the curve has only seen missions all round
_LEAST_SHARE = 0.005  # shares are kept this far from 0 and 1 where their logarithms are taken


@dataclass(frozen=True)
class Calibration:
    """Log-odds of the completeness at 48 mm: ``intercept`` and a weight for each feature."""

    intercept: float = 1.86
    weakest: float = 0.11  # of the log-odds of `Prediction.weakest`
    log_height: float = -0.92  # of the logarithm of the estimated surface's height in metres
    log_bare: float = -0.41  # of the logarithm of `LEAST_BARE` and `Prediction.bare_top` together


CALIBRATION = Calibration()


@dataclass(frozen=True)
class Prediction:
    """What the registered views will reconstruct of the estimated surface."""

    samples_m: Floats  # (S, 3) the observable part of it, evenly
    normals: Floats  # (S, 3)
    chance: Floats32  # (S,) that a sample is reconstructed
    height_m: float  # of its top above the ground
    good: Floats32  # (V, S) how good each registered view is for a match there
    model: SparseModel
    hull: ConvexHull
    config: MissionConfig
    solid: Solid | None = None  # hides samples; None: the surface is convex

    @property
    def weakest(self) -> float:
        """The chance that all but `WEAKEST` of the samples have."""
        return float(np.quantile(self.chance, WEAKEST)) if len(self.chance) else 0.0

    @cached_property
    def bare_top(self) -> float:
        """Share of the top, seen from above, without a sparse point within `BARE_BEYOND` of the height."""
        model = self.model
        on_rock = points_on_rock(model.points_m, self.config)
        if len(on_rock) == 0:
            return 1.0
        seen_m = np.repeat(model.points_m, model.track_lengths, axis=0)
        top_m = carved_top(self.hull, on_rock, model.camera_centers_m[model.track_cameras], seen_m)
        return float((cKDTree(on_rock).query(top_m)[0] > BARE_BEYOND * self.height_m).mean())

    @property
    def completeness(self) -> float:
        """Share of the rock's observable surface within 48 mm of the dense cloud, 0 to 1: three in four clouds have as much."""
        weight = CALIBRATION
        log_odds = (
            weight.intercept
            + weight.weakest * _log_odds(self.weakest)
            + weight.log_height * float(np.log(self.height_m))
            + weight.log_bare * float(np.log(self.bare_top + LEAST_BARE))
        )
        covered = float((self.chance > LEAST_CHANCE).mean()) if len(self.chance) else 0.0
        return min(float(1.0 / (1.0 + np.exp(-log_odds))), covered)

    @property
    def f_score_percent(self) -> float:
        """The F-score at 48 mm, every reconstructed point taken for right."""
        return 200.0 * self.completeness / (1.0 + self.completeness)

    def expected_gain(self, candidates_m: Floats) -> Floats:
        """(C,) share of what will be missing that a view from each candidate (C, 3) would help to reconstruct, in [0, 1].

        A view helps where the surface will be missing, it sees it well, and a view so far sees it at an angle to be
        matched with. Where there is none yet it helps half as much: the next one finds it there.
        """
        missing = np.float32(1.0) - self.chance
        total = float(missing.sum())
        if total <= 0.0 or len(candidates_m) == 0:
            return np.zeros(len(candidates_m))
        worst = np.argsort(-missing, kind="stable")
        worst = worst[: int(np.searchsorted(np.cumsum(missing[worst]), MOST_MISSING * total)) + 1]
        missing = missing[worst]
        samples, normals = self.samples_m[worst], self.normals[worst]
        new = good_view(*_visibility(samples, normals, candidates_m, self.config, self.solid))
        # (V, S) of each view, were it a partner
        unmatched = np.log1p(-np.minimum(self.good[:, worst], np.float32(0.999)))
        # As seen from the target.
        cosine = (
            _directions(candidates_m, self.config) @ _directions(self.model.camera_centers_m, self.config).T
        )
        angle_deg = np.rad2deg(np.arccos(np.clip(cosine, -1.0, 1.0)))
        pair = usable_cosines(cosine, self.config.dense) * np.exp(-CAREFUL_DECAY_PER_DEG * angle_deg)
        partners = pair.astype(np.float32) @ unmatched
        helps = np.float32(0.5) + np.float32(0.5) * (np.float32(1.0) - np.exp(partners))
        gained: Floats = ((new * helps) @ missing).astype(float) / total
        return gained


def predict(model: SparseModel, config: MissionConfig) -> Prediction:
    """What the registered cameras of a sparse model will reconstruct of the surface around its points."""
    points, hull = _estimated_hull(model.points_m, config)
    samples, normals = sample_hull(points, hull, SAMPLES)
    above = samples[:, 2] > 0.0
    samples, normals = samples[above], normals[above]
    seen, _ = _visibility(samples, normals, camera_shell(config), config)
    observable = seen.sum(axis=0) >= FEWEST_OBSERVING
    samples, normals = samples[observable], normals[observable]
    return _prediction(samples, normals, points, hull, model, config)


def predict_carved(model: SparseModel, config: MissionConfig) -> Prediction:
    """`predict` on a surface that can hide itself: what coarse depth shows, and what no line of sight has looked through."""
    near = np.abs(model.depth_m - config.target_m).max(axis=1) <= config.dense.crop_half_width_m
    near &= model.depth_m[:, 2] > GROUND_CLEARANCE_M
    known, cameras_m = model.depth_m[near], model.camera_centers_m
    points, hull = _estimated_hull(np.concatenate([model.points_m, known[:: len(known) // 500 + 1]]), config)
    ends = np.concatenate([np.repeat(model.points_m, model.track_lengths, axis=0), model.depth_m])
    by = np.concatenate([model.track_cameras, model.depth_cameras])
    rng = keyed_rng("carved-surface", len(known))
    known = known[rng.permutation(len(known))[:MOST_KNOWN]]
    lines = rng.permutation(len(by))[:MOST_LINES]
    solid = carved(
        hull,
        known,
        cameras_m[by[lines]],
        ends[lines],
        FINE_CELLS,
        fewest=FEWEST_PLACES,
        share=PLACES_PER_LINE,
    )
    samples, normals = solid.surface(known, CARVED_SAMPLES, rng)
    return _prediction(samples, normals, points, hull, model, config, solid)


def _prediction(
    samples: Floats,
    normals: Floats,
    points: Floats,
    hull: ConvexHull,
    model: SparseModel,
    config: MissionConfig,
    solid: Solid | None = None,
) -> Prediction:
    cameras_m = model.camera_centers_m
    seen, incidence = _visibility(samples, normals, cameras_m, config, solid)
    directions = _directions(cameras_m, config)
    contrast, decay = (
        (CONTRAST, ANGLE_DECAY_PER_DEG) if solid is None else (CAREFUL_CONTRAST, CAREFUL_DECAY_PER_DEG)
    )
    chance = reconstruction_probability(
        seen, incidence, np.full(len(samples), contrast), directions, config.dense, decay
    )
    return Prediction(
        samples_m=samples,
        normals=normals,
        chance=chance,
        height_m=max(float(points[:, 2].max()), 0.1),
        good=good_view(seen, incidence),
        model=model,
        hull=hull,
        config=config,
        solid=solid,
    )


def _estimated_hull(points_m: Floats, config: MissionConfig) -> tuple[Floats, ConvexHull]:
    on_rock = points_on_rock(points_m, config)
    target, sphere = np.array(config.target_m), ball(config)
    if len(on_rock) >= FEWEST_POINTS:
        sphere = target + BALL_WITHIN * (sphere - target)
    points = np.concatenate([on_rock, sphere])
    return points, ConvexHull(points)


def _visibility(
    samples_m: Floats, normals: Floats, cameras_m: Floats, config: MissionConfig, solid: Solid | None = None
) -> tuple[Bools, Floats32]:
    """(V, S) whether each camera, aimed at the target, sees each sample, and the incidence (degrees)."""
    # (c - p) . n / |c - p| by products of matrices: several times as fast as difference by difference.
    cosine = cameras_m @ normals.T - np.einsum("ij,ij->i", samples_m, normals)
    squared = (cameras_m**2).sum(axis=1)[:, None] + (samples_m**2).sum(axis=1) - 2.0 * cameras_m @ samples_m.T
    cosine = (cosine / np.sqrt(squared)).astype(np.float32)
    incidence: Floats32 = np.rad2deg(np.arccos(np.clip(cosine, -1.0, 1.0)))
    inside = in_frustum(samples_m, cameras_m, np.array(config.target_m), config.camera).T
    seen = inside & (incidence <= OBSERVABLE_MAX_INCIDENCE_DEG)
    if solid is not None:
        seen &= ~solid.hides(samples_m, normals, cameras_m, seen)
    return seen, incidence


def _directions(cameras_m: Floats, config: MissionConfig) -> Floats:
    directions = cameras_m - np.array(config.target_m)
    return directions / np.linalg.norm(directions, axis=1, keepdims=True)


def _log_odds(share: float) -> float:
    inside = min(max(share, _LEAST_SHARE), 1.0 - _LEAST_SHARE)
    return float(np.log(inside / (1.0 - inside)))
