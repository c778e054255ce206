"""What the dense cloud will cover: a prediction from the sparse model and coarse depth alone.

The surface is estimated by carving: inside the hull of what was found, whatever no line of sight has looked through is solid. So
a part that no photograph has shown yet exists on it, and it can hide itself. On it the rules of dense stereo
(`nbv.geometry.stereo_chance`) say what the registered views will reconstruct. A logistic curve of their mean chance and of the
share of the surface that no depth has shown, both over what two cameras could see, gives a lower quartile: three in four states
of simulated missions on training rocks and shapes, to which it was fitted, are at least as complete
(``python -m research.predict_completeness fit``; docs/results/index.md).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy

from nbv.config import DenseConfig, MissionConfig
from nbv.geometry.carving import Solid, carved
from nbv.geometry.frames import angles_deg, directions_from
from nbv.geometry.stereo_chance import good_view, logistic, reconstruction_probability
from nbv.geometry.visibility import OBSERVABLE_MAX_INCIDENCE_DEG, in_frustum, incidences_deg, usable_angles
from nbv.process import keyed_rng
from nbv.types import Bools, Floats, Floats32, SparseModel
from nbv.viewpoints import camera_shell

GROUND_CLEARANCE_M = 0.05  # points below are ground, which is at z = 0 to a few centimetres
STRAY_NEIGHBOURS = 10  # a point whose 10th neighbour is three times as far as usual is a stray
STRAY_SPACINGS = 3.0
BALL_POINTS = 200
FEWEST_POINTS = 20  # fewer say nothing of a shape
SAMPLES = 600
CELLS = 28  # of the height of the surface
MOST_KNOWN, MOST_LINES = 60_000, 60_000  # places with depth, and lines of sight, that it is made from
# A cube is solid for certain with so many places, and so many for each line of sight that crosses it: one depth in twenty is wrong.
FEWEST_PLACES, PLACES_PER_LINE = 3, 0.3
BALL_WITHIN = 0.75  # of the ball about the target, where there are points enough
# For the completeness, of the rock's texture and of the angle between two views: fitted to orbits of 12 to 24 photographs of four
# training rocks in `indoors`.
CONTRAST, ANGLE_DECAY_PER_DEG = 0.009, 0.02
# For the gain, what pairs of views are worth by the angle between them: most at `PAIR_DEG`, less by the difference of the logarithms
# (standard deviation); and the log-odds of a place by the pairs that see it. Fitted to the clouds of 21 photographed training
# missions in `indoors` (docs/results/where_planning_pays.md).
PAIR_DEG, PAIR_SPREAD, PAIR_LEAST = 10.0, 0.45, 0.03
LOG_ODDS, LOG_ODDS_BY_PAIRS, LEAST_PAIRS = 0.5, 1.1, 0.1
# How well a place matches is how many cameras have depth there for what its pairs are worth, both with so many more.
SUPPORT_PRIOR, PAIRS_PRIOR = 1.0, 1.0
MOST_AT_ONCE = 4  # photographs that are judged together: a place that none shows yet needs some from nearly one direction
_PARTNERS, _PARTNERS_FROM_DEG = 8, 6.0  # so many candidates may join another, the nearest from this angle on
FEWEST_OBSERVING = 2
LEAST_UNKNOWN = 0.01  # is added to the unknown share where its logarithm is taken
_LEAST_SHARE = 0.005  # shares are kept this far from 0 and 1 where their logarithms are taken


@dataclass(frozen=True)
class Calibration:
    """Log-odds of the completeness at 48 mm: ``intercept`` and a weight for each feature."""

    intercept: float = 0.18
    mean_chance: float = 0.33  # of the log-odds of `Prediction.mean_chance`
    log_unknown: float = -0.67  # of the logarithm of `LEAST_UNKNOWN` and `Prediction.unknown` together


CALIBRATION = Calibration()


@dataclass(frozen=True)
class Prediction:
    """What the registered views will reconstruct of the estimated surface, on a ground at z = 0."""

    samples_m: Floats  # (S, 3) of it, evenly
    normals: Floats  # (S, 3)
    shown: Bools  # (S,) whether depth has shown the place
    chance: Floats32  # (S,) that a sample is reconstructed, whatever its texture
    matches: Floats32  # (S,) how well a sample has matched so far, by what its pairs of views lead to expect
    good: Floats32  # (V, S) how good each registered view is for a match there
    model: SparseModel
    config: MissionConfig
    solid: Solid  # hides samples

    @cached_property
    def observable(self) -> Bools:
        """(S,) whether two of the cameras that may be flown see a sample."""
        seen, _ = _visibility(
            self.samples_m, self.normals, camera_shell(self.config), self.config, self.solid
        )
        return np.asarray(seen.sum(axis=0) >= FEWEST_OBSERVING)

    @property
    def mean_chance(self) -> float:
        return float(self.chance[self.observable].mean()) if self.observable.any() else 0.0

    @property
    def unknown(self) -> float:
        """The share of the observable surface that no depth has shown."""
        return float(1.0 - self.shown[self.observable].mean()) if self.observable.any() else 1.0

    @property
    def completeness(self) -> float:
        """Share of the rock's observable surface within 48 mm of the dense cloud, 0 to 1: three in four clouds have as much."""
        weight = CALIBRATION
        chance = min(max(self.mean_chance, _LEAST_SHARE), 1.0 - _LEAST_SHARE)
        log_odds = (
            weight.intercept
            + weight.mean_chance * float(np.log(chance / (1.0 - chance)))
            + weight.log_unknown * float(np.log(self.unknown + LEAST_UNKNOWN))
        )
        return float(1.0 / (1.0 + np.exp(-log_odds)))

    @property
    def f_score_percent(self) -> float:
        """The F-score at 48 mm, every reconstructed point taken for right."""
        return 200.0 * self.completeness / (1.0 + self.completeness)

    @cached_property
    def pairs(self) -> Floats32:
        """(S,) what the pairs of registered views are worth together."""
        return _worth_of_pairs(self.good, self._directions(self.model.camera_centers_m), self.config.dense)

    @cached_property
    def matched(self) -> Floats32:
        """(S,) chance that a sample is reconstructed, by how well it has matched so far."""
        return _chance(self.pairs * self.matches)

    def expected_share(self, cameras_m: Floats) -> float:
        """Share of the estimated surface that photographs from these places (V, 3) alone would reconstruct, 0 to 1."""
        cameras_m = cameras_m - [0.0, 0.0, self.config.target.ground_m]
        good = good_view(*_visibility(self.samples_m, self.normals, cameras_m, self.config, self.solid))
        pairs = _worth_of_pairs(good, self._directions(cameras_m), self.config.dense)
        return float(_chance(pairs * self.matches).mean())

    def expected_gain(self, candidates_m: Floats, left: int = 1) -> Floats:
        """(C,) share of what will be missing that a photograph from each candidate (C, 3) reconstructs, in [0, 1].

        ``left`` photographs may still be taken. A candidate counts with up to `MOST_AT_ONCE` - 1 others beside it that go best with
        it, and then for the mean of these photographs: of a place that none shows so far one alone reconstructs nothing.
        """
        total = float((np.float32(1.0) - self.matched).sum())
        if total <= 0.0 or len(candidates_m) == 0:
            return np.zeros(len(candidates_m))
        candidates_m = candidates_m - [0.0, 0.0, self.config.target.ground_m]
        new = good_view(*_visibility(self.samples_m, self.normals, candidates_m, self.config, self.solid))
        toward = self._directions(candidates_m)
        angle_deg = angles_deg(toward, toward)
        worth = _pair_worth(angle_deg, self.config.dense)
        registered = angles_deg(toward, self._directions(self.model.camera_centers_m))
        alone = new * (_pair_worth(registered, self.config.dense) @ self.good)

        def reconstructed(more: Floats32) -> Floats32:  # (..., S)
            return (_chance((self.pairs + more) * self.matches) - self.matched).sum(axis=-1)

        each = np.arange(len(candidates_m))
        apart = np.where(angle_deg < _PARTNERS_FROM_DEG, np.inf, angle_deg)
        partners = np.argsort(apart, axis=1, kind="stable")[:, :_PARTNERS]
        group, brought = each[:, None], alone
        best = reconstructed(brought)
        for size in range(2, min(left, MOST_AT_ONCE, partners.shape[1]) + 1):
            # (C, K, S) with each partner in turn
            among = np.einsum("ckg,cgs->cks", worth[partners[:, :, None], group[:, None]], new[group])
            more = brought[:, None] + alone[partners] + new[partners] * among
            gain = np.where(
                (partners[:, :, None] == group[:, None]).any(axis=2), -np.inf, reconstructed(more)
            )
            chosen = gain.argmax(axis=1)
            group, brought = np.column_stack([group, partners[each, chosen]]), more[each, chosen]
            best = np.maximum(best, gain[each, chosen] / np.float32(size))
        return best.astype(float) / total

    def _directions(self, cameras_m: Floats) -> Floats:
        return directions_from(self.config.target_m, cameras_m)


def predict(model: SparseModel, config: MissionConfig) -> Prediction:
    """What the registered cameras of a sparse model will reconstruct of the surface that it and its coarse depth show."""
    down_m = np.array([0.0, 0.0, config.target.ground_m])
    x, y, z = config.target_m
    config = config.changed(target_m=(x, y, z - config.target.ground_m))
    model = replace(
        model,
        points_m=model.points_m - down_m,
        depth_m=model.depth_m - down_m,
        camera_centers_m=model.camera_centers_m - down_m,
    )
    near = np.abs(model.depth_m - config.target_m).max(axis=1) <= config.dense.crop_half_width_m
    near &= model.depth_m[:, 2] > GROUND_CLEARANCE_M
    places, cameras_m = model.depth_m[near], model.camera_centers_m
    known = places
    on_rock = points_on_rock(np.concatenate([model.points_m, known[:: len(known) // 500 + 1]]), config)
    target, sphere = np.array(config.target_m), ball(config)
    if len(on_rock) >= FEWEST_POINTS:
        sphere = target + BALL_WITHIN * (sphere - target)
    hull = scipy.spatial.ConvexHull(np.concatenate([on_rock, sphere]))
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
        CELLS,
        fewest=FEWEST_PLACES,
        share=PLACES_PER_LINE,
    )
    samples, normals, shown = solid.surface(known, SAMPLES, rng)
    seen, incidence = _visibility(samples, normals, cameras_m, config, solid)
    good = good_view(seen, incidence)
    directions = directions_from(config.target_m, cameras_m)
    pairs = _worth_of_pairs(good, directions, config.dense)
    support = solid.cameras_at(samples, places, model.depth_cameras[near])
    matches = ((support + SUPPORT_PRIOR) / (pairs + PAIRS_PRIOR)).astype(np.float32)
    contrast = np.full(len(samples), CONTRAST)
    chance = reconstruction_probability(
        seen, incidence, contrast, directions, config.dense, ANGLE_DECAY_PER_DEG
    )
    return Prediction(samples, normals, shown, chance, matches, good, model, config, solid)


def _pair_worth(angle_deg: Floats, dense: DenseConfig) -> Floats32:
    """What a pair of views with this angle between them is worth; 0 where dense stereo does not match it."""
    off = np.log(np.maximum(angle_deg, 1e-3) / PAIR_DEG) / PAIR_SPREAD
    worth = np.where(usable_angles(angle_deg, dense), np.exp(-0.5 * off**2) + PAIR_LEAST, 0.0)
    return worth.astype(np.float32)


def _worth_of_pairs(good: Floats32, directions: Floats, dense: DenseConfig) -> Floats32:
    """(S,) of all pairs of the views (V, S), each in so far as both are good there."""
    between = _pair_worth(angles_deg(directions, directions), dense)
    return np.asarray(0.5 * (good * (between @ good)).sum(axis=0), dtype=np.float32)


def _chance(pairs: Floats32) -> Floats32:
    """That a place is reconstructed which pairs of so much worth see."""
    return logistic(
        np.float32(LOG_ODDS) + np.float32(LOG_ODDS_BY_PAIRS) * np.log(pairs + np.float32(LEAST_PAIRS))
    )


def _visibility(
    samples_m: Floats, normals: Floats, cameras_m: Floats, config: MissionConfig, solid: Solid
) -> tuple[Bools, Floats32]:
    """(V, S) whether each camera, aimed at the target, sees each sample, and the incidence (degrees)."""
    incidence = incidences_deg(samples_m, normals, cameras_m)
    inside = in_frustum(samples_m, cameras_m, np.array(config.target_m), config.camera).T
    seen = inside & (incidence <= OBSERVABLE_MAX_INCIDENCE_DEG)
    seen &= ~solid.hides(samples_m, normals, cameras_m, seen)
    return seen, incidence


def points_on_rock(points_m: Floats, config: MissionConfig) -> Floats:
    """(K, 3) of points (N, 3) those above the ground within the dense stage's crop around the target, less strays."""
    offset = np.abs(points_m[:, :2] - config.target_m[:2])
    near = (offset.max(axis=1, initial=0.0) <= config.dense.crop_half_width_m) & (
        points_m[:, 2] > GROUND_CLEARANCE_M
    )
    points = points_m[near]
    if len(points) > STRAY_NEIGHBOURS:
        distance = scipy.spatial.cKDTree(points).query(points, k=STRAY_NEIGHBOURS + 1)[0][:, -1]
        points = points[distance <= STRAY_SPACINGS * np.median(distance)]
    return points


def ball(config: MissionConfig) -> Floats:
    """(BALL_POINTS, 3) evenly on the sphere about the target that touches the ground (Fibonacci lattice)."""
    k = np.arange(BALL_POINTS) + 0.5
    up, bearing = 1.0 - 2.0 * k / BALL_POINTS, k * np.pi * (3.0 - np.sqrt(5.0))
    level = np.sqrt(1.0 - up**2)
    directions = np.column_stack([level * np.cos(bearing), level * np.sin(bearing), up])
    return np.array(config.target_m) + config.target_m[2] * directions
