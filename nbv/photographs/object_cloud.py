"""Of a dense cloud what belongs to the object, and where it is not to be trusted."""

from __future__ import annotations

import numpy as np

from nbv.config import EvaluationConfig
from nbv.errors import UserError
from nbv.evaluation.cleaning import inlier_mask, select
from nbv.geometry.neighbours import nearest_neighbours
from nbv.geometry.target import GROUND_BAND_M
from nbv.photographs.object_frame import ObjectFrame
from nbv.photographs.photograph_set import THRESHOLD_FRACTIONS
from nbv.photographs.reference_file import Reference
from nbv.types import Bools, Floats, PointCloud

MARGIN = 0.05  # about the object's box, as a share of its largest side
SECTORS = 12
WEAK_SHARE = 0.25  # of a sector's points beyond the middle threshold make it weak
SPARSE_SHARE = 0.3  # of the median number of points in a sector make it thin
FEWEST_POINTS = 1000
_WEAK_AT = THRESHOLD_FRACTIONS[2]


def in_box(points_m: Floats, frame: ObjectFrame) -> Bools:
    """(N,) which of points (N, 3) lie in the object's box or a little beyond."""
    margin = MARGIN * float((frame.high_m - frame.low_m).max())
    inside: Bools = np.all((points_m >= frame.low_m - margin) & (points_m <= frame.high_m + margin), axis=1)
    return inside


def object_cloud(cloud: PointCloud, frame: ObjectFrame, *, masked: bool) -> PointCloud:
    """The points in the object's box, off the ground where no masks say what is the object, without outliers.

    Raises
    ------
    UserError
        Hardly anything is left.
    """
    points = cloud.points_m
    inside = in_box(points, frame)
    if not masked:
        inside &= points[:, 2] > frame.low_m[2] + GROUND_BAND_M
    kept = select(cloud, inside)
    config = EvaluationConfig()
    if len(kept) > config.sor_neighbours:
        distances = nearest_neighbours(kept.points_m, kept.points_m, k=config.sor_neighbours + 1)[0][:, 1:]
        kept = select(kept, inlier_mask(distances, config.sor_std_ratio))
    if len(kept) < FEWEST_POINTS:
        raise UserError(
            f"only {len(kept)} points of the object could be reconstructed; give more photographs that overlap, "
            "or masks of the object (--masks)"
        )
    return kept


def weak_places(reference: Reference, height_m: float) -> tuple[str, ...]:
    """Sentences on the sides of the object where the halves disagree or hardly a point is."""
    x, y, _ = reference.points_m.T
    sector = (np.rad2deg(np.arctan2(y, x)) % 360 // (360 / SECTORS)).astype(int)
    counts = np.bincount(sector, minlength=SECTORS)
    weak = np.bincount(sector, weights=reference.error_m > _WEAK_AT * height_m, minlength=SECTORS)
    thin = counts < SPARSE_SHARE * np.median(counts)
    share = weak / np.maximum(counts, 1)
    width_deg = 360 // SECTORS
    sentences = []
    for start, stop in _runs(thin):
        sentences.append(f"azimuth {width_deg * start}° to {width_deg * stop}°: hardly any points")
    for start, stop in _runs(~thin & (share > WEAK_SHARE)):
        percent = 100 * weak[start:stop].sum() / counts[start:stop].sum()
        sentences.append(
            f"azimuth {width_deg * start}° to {width_deg * stop}°: {percent:.0f} % of the points are farther than "
            f"{100 * _WEAK_AT:.0f} % of the height from the cloud of one half"
        )
    return tuple(sentences)


def _runs(marked: Bools) -> list[tuple[int, int]]:
    """Begin and end (excluded) of the runs of True."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], marked, [False]]).astype(int)))
    return [(int(start), int(stop)) for start, stop in edges.reshape(-1, 2)]
