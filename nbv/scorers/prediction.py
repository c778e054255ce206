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
from scipy.spatial import ConvexHull

from nbv.config import MissionConfig
from nbv.geometry.carving import Solid, carved
from nbv.geometry.frames import directions_from
from nbv.geometry.matchability import usable_cosines
from nbv.geometry.stereo_chance import good_view, reconstruction_probability
from nbv.geometry.visibility import OBSERVABLE_MAX_INCIDENCE_DEG, in_frustum, incidences_deg
from nbv.random_streams import keyed_rng
from nbv.scorers.surface import FEWEST_POINTS, GROUND_CLEARANCE_M, ball, points_on_rock
from nbv.types import Bools, Floats, Floats32, SparseModel
from nbv.viewpoints import camera_shell

SAMPLES = 600
CELLS = 28  # of the height of the surface
MOST_KNOWN, MOST_LINES = 60_000, 60_000  # places with depth, and lines of sight, that it is made from
# A cube is solid for certain with so many places, and so many for each line of sight that crosses it: one depth in twenty is wrong.
FEWEST_PLACES, PLACES_PER_LINE = 3, 0.3
BALL_WITHIN = 0.75  # of the ball about the target, where there are points enough
# Of the rock's texture, which nothing says, and of the angle between two views: fitted to orbits of 12 to 24 photographs of four
# training rocks in `indoors`, whose noise costs wide pairs most (docs/results/where_planning_pays.md).
CONTRAST, ANGLE_DECAY_PER_DEG = 0.009, 0.02
FEWEST_OBSERVING = 2
LEAST_UNKNOWN = 0.01  # is added to the unknown share where its logarithm is taken
MOST_MISSING = 0.98  # of what will be missing decides; the many samples of the rest take time
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
    chance: Floats32  # (S,) that a sample is reconstructed
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
        log_odds = (
            weight.intercept
            + weight.mean_chance * _log_odds(self.mean_chance)
            + weight.log_unknown * float(np.log(self.unknown + LEAST_UNKNOWN))
        )
        return float(1.0 / (1.0 + np.exp(-log_odds)))

    @property
    def f_score_percent(self) -> float:
        """The F-score at 48 mm, every reconstructed point taken for right."""
        return 200.0 * self.completeness / (1.0 + self.completeness)

    def expected_gain(self, candidates_m: Floats) -> Floats:
        """(C,) share of what will be missing that a view from each candidate (C, 3) would help to reconstruct, in [0, 1].

        A view helps where the surface will be missing, it sees it well, and a view so far sees it at an angle to be
        matched with. Where there is none yet it helps half as much: the next one finds it there.
        """
        candidates_m = candidates_m - [0.0, 0.0, self.config.target.ground_m]
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
        target_m = self.config.target_m
        to_cameras = directions_from(target_m, self.model.camera_centers_m)
        cosine = directions_from(target_m, candidates_m) @ to_cameras.T
        angle_deg = np.rad2deg(np.arccos(np.clip(cosine, -1.0, 1.0)))
        pair = usable_cosines(cosine, self.config.dense) * np.exp(-ANGLE_DECAY_PER_DEG * angle_deg)
        partners = pair.astype(np.float32) @ unmatched
        helps = np.float32(0.5) + np.float32(0.5) * (np.float32(1.0) - np.exp(partners))
        gained: Floats = ((new * helps) @ missing).astype(float) / total
        return gained


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
    known, cameras_m = model.depth_m[near], model.camera_centers_m
    hull = _estimated_hull(np.concatenate([model.points_m, known[:: len(known) // 500 + 1]]), config)
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
    contrast, directions = np.full(len(samples), CONTRAST), directions_from(config.target_m, cameras_m)
    chance = reconstruction_probability(
        seen, incidence, contrast, directions, config.dense, ANGLE_DECAY_PER_DEG
    )
    return Prediction(samples, normals, shown, chance, good_view(seen, incidence), model, config, solid)


def _estimated_hull(points_m: Floats, config: MissionConfig) -> ConvexHull:
    on_rock = points_on_rock(points_m, config)
    target, sphere = np.array(config.target_m), ball(config)
    if len(on_rock) >= FEWEST_POINTS:
        sphere = target + BALL_WITHIN * (sphere - target)
    return ConvexHull(np.concatenate([on_rock, sphere]))


def _visibility(
    samples_m: Floats, normals: Floats, cameras_m: Floats, config: MissionConfig, solid: Solid
) -> tuple[Bools, Floats32]:
    """(V, S) whether each camera, aimed at the target, sees each sample, and the incidence (degrees)."""
    incidence = incidences_deg(samples_m, normals, cameras_m)
    inside = in_frustum(samples_m, cameras_m, np.array(config.target_m), config.camera).T
    seen = inside & (incidence <= OBSERVABLE_MAX_INCIDENCE_DEG)
    seen &= ~solid.hides(samples_m, normals, cameras_m, seen)
    return seen, incidence


def _log_odds(share: float) -> float:
    inside = min(max(share, _LEAST_SHARE), 1.0 - _LEAST_SHARE)
    return float(np.log(inside / (1.0 - inside)))
