"""Rankings by scorer: `Rankings` is what the mission asks for."""

from __future__ import annotations

import numpy as np

from nbv.cache import Recent, digest
from nbv.config import SCORERS, BAwareConfig, MissionConfig
from nbv.geometry.visibility import neighbour_distances
from nbv.scorers.prediction import Prediction, predict
from nbv.scorers.scorer import Scorer, SharedTerms, shared_terms
from nbv.types import CandidatePool, Floats, PlanningState, Ranking, SparseModel

# Co-visibility (Covis): how much of the existing sparse model a candidate would see again.


def co_visibility(terms: SharedTerms, pool: CandidatePool, config: MissionConfig) -> Floats:
    """Eq. 5: (C,) fraction of the P > 0 tracked points in the box that each candidate sees."""
    return np.count_nonzero(terms.visible, axis=0) / len(terms.visible)


COVIS = Scorer("covis", co_visibility, weights=lambda config: config.covis.weights)


# Baseline-aware repair (B-aware): weak points, seen from angles that are new to them.


BLOCK = 256  # points at a time: a block's (BLOCK, C) arrays stay in the processor's cache


def percentile_scaled(values: Floats) -> Floats:
    """Values scaled so that their 5th and 95th percentiles are 0 and 1, clipped; all 0 if these coincide."""
    low, high = np.percentile(values, (5.0, 95.0))
    if high - low < 1e-8:
        return np.zeros_like(values)
    return np.clip((values - low) / (high - low), 0.0, 1.0)


def mean_neighbour_distance(points_m: Floats, neighbours: int) -> Floats:
    """(P,) mean distance to the nearest ``neighbours`` other points; zeros for a single point."""
    k = min(neighbours, len(points_m) - 1)
    if k < 1:
        return np.zeros(len(points_m))
    # Row by row a mean of a few numbers takes several times as long.
    return np.ascontiguousarray(neighbour_distances(points_m, k).T).mean(axis=0)


def weakness(box: SparseModel, config: BAwareConfig) -> Floats:
    """Eq. 6: (P,) weakness in [0, 1] of the tracked points in the box.

    Inverse track support and local sparsity; with ``alpha_reprojection`` (0 in the paper's text, 0.2
    in the authors' code) also the percentile-scaled reprojection error.
    """
    target, errors_px = config.target_track_length, box.reprojection_error_px
    w = config.alpha_track * np.clip((target - box.track_lengths) / target, 0.0, 1.0)
    if config.alpha_density > 0:
        spread = mean_neighbour_distance(box.points_m, config.density_neighbours)
        w = w + config.alpha_density * percentile_scaled(spread)
    if config.alpha_reprojection > 0 and np.any(errors_px > 0):
        w = w + config.alpha_reprojection * percentile_scaled(errors_px)
    return np.clip(w, 0.0, 1.0)


def geometry_gain(candidates_m: Floats, box: SparseModel, config: BAwareConfig) -> Floats:
    """Eq. 7: (P, C) gain of the ray from each candidate (C, 3) to each of the P points, in [0, 1].

    Up to ``theta_low_deg`` from the nearest existing observation ray the gain is 0; from ``theta_saturation_deg`` on, and
    where a point has no observation, it is 1.
    """
    low, high = np.deg2rad(config.theta_low_deg), np.deg2rad(config.theta_saturation_deg)
    one = np.ones((1, len(candidates_m)))
    minus_c = np.concatenate([-candidates_m.T, one])
    for_distance = np.concatenate([-2.0 * candidates_m.T, one, (candidates_m**2).sum(axis=1)[None]])
    lengths = box.track_lengths
    # (T, 4) every observation's ray from camera to point, a unit vector, and its dot product with the point.
    seen_m = box.points_m.repeat(lengths, axis=0)
    ray = seen_m - box.camera_centers_m[box.track_cameras]
    ray /= np.sqrt(np.einsum("ij,ij->i", ray, ray))[:, None]
    rays = np.column_stack([ray, np.einsum("ij,ij->i", ray, seen_m)])
    longest_first = np.argsort(-lengths, kind="stable")
    gain = np.empty((len(lengths), len(candidates_m)))
    for start in range(0, len(lengths), BLOCK):
        rows = longest_first[start : start + BLOCK]
        points_m, longest = box.points_m[rows], lengths[rows[0]]
        # |p - c| cos(angle to the nearest ray): (p - c) . ray = ray . p - ray . c, the largest of each point's rays
        nearest = np.full((len(rows), len(candidates_m)), -np.inf)
        for j, count in enumerate(np.count_nonzero(lengths[rows, None] > np.arange(longest), axis=0)):
            along = (
                rays[box.track_offsets[rows[:count]] + j] @ minus_c
            )  # of the first so many, whose tracks are longer
            np.maximum(nearest[:count], along, out=nearest[:count])
        squared = np.column_stack([points_m, np.einsum("ij,ij->i", points_m, points_m), np.ones(len(rows))])
        # A candidate may be on a point: no division by zero.
        nearest /= np.sqrt(np.maximum(squared @ for_distance, 1e-16))
        np.clip(nearest, np.cos(high), np.cos(low), out=nearest)
        gain[rows] = (np.arccos(nearest, out=nearest) - low) / (high - low)
    return np.clip(gain, 0.0, 1.0, out=gain)


def repair_share(terms: SharedTerms, pool: CandidatePool, config: MissionConfig) -> Floats:
    """Eq. 8: (C,) share of all weakness (Eq. 6) that each candidate would repair, of the points that it sees.

    If no point is weak there is nothing to repair: zeros, through the reference's guard of 1e-8 on the denominator.
    """
    weak = weakness(terms.box, config.b_aware)
    gain = geometry_gain(pool.positions_m, terms.box, config.b_aware)
    gain *= terms.visible
    return weak @ gain / max(float(weak.sum()), 1e-8)


B_AWARE = Scorer("b-aware", repair_share, weights=lambda config: config.b_aware.weights)


# Predicted: how much of what the dense cloud will lack a candidate reconstructs, for each photograph. It is not in the paper.


# Whether a value has an effect is tried by missions that come to the same states again and again.
_KNOWN_GAINS: Recent[Floats] = Recent(256)


def expected_gain_share(terms: SharedTerms, pool: CandidatePool, config: MissionConfig) -> Floats:
    """(C,) share of what will be missing that a photograph from each candidate reconstructs."""
    model = terms.model
    arrays = model.points_m, model.track_offsets, model.track_cameras, model.depth_m, model.depth_cameras
    read = [config.target_m, config.target, config.dense, config.camera]  # of the configuration
    key = digest(*arrays, model.camera_centers_m, pool.positions_m, *read, terms.left)

    def make() -> Floats:
        prediction = terms.prediction or predict(model, config)
        return prediction.expected_gain(pool.positions_m, terms.left)

    return _KNOWN_GAINS.get(key, make)


PREDICTED = Scorer("predicted", expected_gain_share, weights=lambda config: config.predicted.weights)


BUILT_IN = {scorer.name: scorer for scorer in (COVIS, B_AWARE, PREDICTED)}


class Rankings(dict[str, Ranking]):
    """One pool's rankings by scorer: the paper's two, and any other as soon as it is asked for by name.

    The pool is not empty. `UserError` for a name that no scorer has; `MissionFailure` for a scorer that the state gives nothing to work with.
    """

    def __init__(
        self,
        state: PlanningState,
        pool: CandidatePool,
        config: MissionConfig,
        prediction: Prediction | None = None,
    ) -> None:
        super().__init__()
        self._terms = shared_terms(state, pool, config, prediction)
        self._pool, self._config = pool, config
        for paper in (COVIS, B_AWARE):  # the traces say what either would have chosen, whatever the gate
            self[paper.name]

    def __missing__(self, name: str) -> Ranking:
        scorer = SCORERS.load(name, BUILT_IN)
        ranking = self[name] = scorer.rank(self._terms, self._pool, self._config)
        return ranking
