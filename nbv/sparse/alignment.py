"""From the model's arbitrary frame to the world: similarity alignment of camera centres with telemetry.

A wrong model must be noticed, never scored: a repetitive ground once gave a self-consistent model whose
cameras were 4 m off. So the alignment is robust (a minority of wrong cameras is found and named) and
suspicious (residuals, spread, handedness and viewing directions are all checked).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from nbv.config import TelemetryConfig
from nbv.errors import MissionFailure
from nbv.geometry.frames import Similarity, align_umeyama, camera_centers_m, rotation_angles_deg
from nbv.types import Floats, Ints

MIN_CAMERAS = 3
MIN_INLIER_FRACTION = 0.75  # fewer cameras in agreement than this: the model is wrong, not the cameras
MAX_ROTATION_ERROR_DEG = 10.0  # optical axis and roll against telemetry; a mirrored model is far beyond
OUTLIER_FACTOR = 5.0  # a camera this many times farther off than the rest is an outlier
_TRIPLES = 200
_MIN_TRIPLE_RATIO = 0.1  # a triple of cameras this flat cannot fix a similarity


@dataclass(frozen=True)
class Alignment:
    """``world_from_model`` and how well it fits each registered camera, in the given order."""

    world_from_model: Similarity
    residuals_m: Floats  # (M,) distance of each camera centre from its telemetry
    rotation_errors_deg: Floats  # (M,)
    inliers: Ints  # indices of the cameras that the similarity was fitted to

    @property
    def rms_m(self) -> float:
        """Root mean square residual of the fitted cameras."""
        return float(np.sqrt((self.residuals_m[self.inliers] ** 2).mean()))

    @property
    def max_m(self) -> float:
        """Largest residual of the fitted cameras."""
        return float(self.residuals_m[self.inliers].max())

    @property
    def outliers(self) -> Ints:
        """Indices of the cameras that disagree with the rest."""
        return np.setdiff1d(np.arange(len(self.residuals_m)), self.inliers)


def outlier_limit_m(rms_m: float, max_alignment_rms_m: float) -> float:
    """Residual (m) beyond which a camera is an outlier: 5 times the rest's, but never below the tolerance."""
    return max(OUTLIER_FACTOR * rms_m, max_alignment_rms_m)


def align_cameras(
    camera_from_model: Floats,
    camera_from_world: Floats,
    max_rms_m: float,
    telemetry: TelemetryConfig | None = None,
) -> Alignment:
    """Align registered cameras (M, 4, 4) with their telemetry (M, 4, 4).

    A least-squares similarity (Umeyama 1991) on the centres; where ``telemetry`` errs its attitudes count too, since drift
    turns a ring of positions by degrees. If a residual exceeds ``max_rms_m`` the fit is repeated on the largest agreeing
    subset (least median of squares over camera triples).

    `MissionFailure` ``wrong_model``: fewer than 3 cameras, a collapsed or mirrored model, too few cameras in agreement, or a
    residual beyond ``max_rms_m``.
    """
    source, target = camera_centers_m(camera_from_model), camera_centers_m(camera_from_world)
    count = len(source)
    if count < MIN_CAMERAS:
        raise MissionFailure("wrong_model", f"only {count} cameras are registered, alignment needs 3")
    if not np.isfinite(source).all():
        raise MissionFailure("wrong_model", "the model has camera centres that are not finite")
    if _spread(source) < 1e-6 * max(1.0, float(np.abs(source).max())):
        raise MissionFailure("wrong_model", "the model has collapsed: all camera centres coincide")
    if np.linalg.matrix_rank(target - target.mean(0), tol=1e-3 * _spread(target)) < 2:
        raise MissionFailure("wrong_model", "the cameras lie on one line, which cannot fix an orientation")

    inliers = np.arange(count)
    similarity = align_umeyama(target, source)
    residuals = np.linalg.norm(similarity.apply(source) - target, axis=1)
    if residuals.max() > max_rms_m:
        inliers = _agreeing(source, target, max_rms_m)
        if len(inliers) >= max(MIN_CAMERAS, MIN_INLIER_FRACTION * count):
            similarity = align_umeyama(target[inliers], source[inliers])
            residuals = np.linalg.norm(similarity.apply(source) - target, axis=1)
        else:
            inliers = np.arange(count)  # report the plain fit, which fails below

    if telemetry is not None and telemetry.attitude_noise_deg > 0:
        similarity = turned_by_attitude(
            similarity, camera_from_model[inliers], camera_from_world[inliers], telemetry
        )
        residuals = np.linalg.norm(similarity.apply(source) - target, axis=1)

    turns = _rotation_errors_deg(camera_from_model, camera_from_world, similarity.rotation)
    alignment = Alignment(similarity, residuals, turns, inliers)
    if not np.isfinite(alignment.rms_m) or alignment.rms_m > max_rms_m or similarity.scale <= 0:
        raise MissionFailure(
            "wrong_model",
            f"camera centres differ from telemetry by {alignment.rms_m:.3f} m rms "
            f"(tolerance {max_rms_m:g} m)",
        )
    median_rotation = float(np.median(alignment.rotation_errors_deg[inliers]))
    if median_rotation > MAX_ROTATION_ERROR_DEG:
        raise MissionFailure(
            "wrong_model",
            f"camera orientations differ from telemetry by {median_rotation:.1f} deg (median): "
            "the model is mirrored or flipped",
        )
    return alignment


def turned_by_attitude(
    world_from_model: Similarity,
    camera_from_model: Floats,
    camera_from_world: Floats,
    telemetry: TelemetryConfig,
) -> Similarity:
    """The similarity that fits centres and attitudes (M, 4, 4), each weighted by the telemetry's variance.

    Least squares in the chordal metric, ``|R - R_i|^2 = 2 angle^2``: orthogonal Procrustes on the weighted sum of both
    kinds of residuals, at the scale of ``world_from_model``; then scale and translation for that rotation.
    """
    source, target = camera_centers_m(camera_from_model), camera_centers_m(camera_from_world)
    x, y = source - source.mean(0), target - target.mean(0)
    by_attitude = np.einsum("mji,mjk->ik", camera_from_world[:, :3, :3], camera_from_model[:, :3, :3])
    position_variance_m2 = sum(telemetry.covariance_m2) / 3
    attitude_variance = np.deg2rad(telemetry.attitude_noise_deg) ** 2
    both = world_from_model.scale * y.T @ x / position_variance_m2 + by_attitude / (2 * attitude_variance)
    rotation = _nearest_rotation(both)
    scale = float((y * (x @ rotation.T)).sum() / (x**2).sum())
    return Similarity(scale, rotation, target.mean(0) - scale * rotation @ source.mean(0))


def turns_deg(camera_from_model: Floats, camera_from_world: Floats) -> Floats:
    """(M,) angle between each camera's attitude and its telemetry, at the rotation that fits all attitudes best."""
    both = np.einsum("mji,mjk->ik", camera_from_world[:, :3, :3], camera_from_model[:, :3, :3])
    return _rotation_errors_deg(camera_from_model, camera_from_world, _nearest_rotation(both))


def _nearest_rotation(matrix: Floats) -> Floats:
    """(3, 3) the rotation of the orthogonal Procrustes problem (Schönemann 1966) with positive determinant."""
    u, _, vt = np.linalg.svd(matrix)
    rotation: Floats = (u * [1.0, 1.0, np.linalg.det(u) * np.linalg.det(vt)]) @ vt
    return rotation


def _spread(points: Floats) -> float:
    return float(np.sqrt(((points - points.mean(0)) ** 2).sum(1).mean()))


def _rotation_errors_deg(
    camera_from_model: Floats, camera_from_world: Floats, world_from_model: Floats
) -> Floats:
    """(M,) angle between each camera's orientation and its telemetry, turned by ``world_from_model`` (3, 3)."""
    aligned = camera_from_model[:, :3, :3] @ world_from_model.T
    relative = np.einsum("mij,mkj->mik", aligned, camera_from_world[:, :3, :3])
    return rotation_angles_deg(relative)


def _agreeing(source: Floats, target: Floats, max_rms_m: float) -> Ints:
    """Indices of the largest set of cameras found that one similarity fits within the outlier limit."""
    rng = np.random.default_rng(0)
    count = len(source)
    best: Ints = np.arange(0)
    best_median = np.inf
    flat = _MIN_TRIPLE_RATIO * _spread(target) ** 2
    for _ in range(_TRIPLES):
        triple = rng.choice(count, 3, replace=False)
        edge_a, edge_b = target[triple[1:]] - target[triple[0]]
        if np.linalg.norm(np.cross(edge_a, edge_b)) < flat or _spread(source[triple]) < 1e-9:
            continue
        fit = align_umeyama(target[triple], source[triple])
        residuals = np.linalg.norm(fit.apply(source) - target, axis=1)
        median = float(np.median(residuals))
        if median < best_median:
            best_median = median
            best = np.flatnonzero(residuals <= outlier_limit_m(1.4826 * median, max_rms_m))
    return best
