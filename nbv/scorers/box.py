"""The points that scorers look at: tracked points in the box around the target."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from nbv.config import MissionConfig
from nbv.types import Floats, Ints, SparseModel


@dataclass(frozen=True)
class BoxPoints:
    """The point set of Eq. 5 and 8: tracked points in the box around the target, tracks in CSR form."""

    points_m: Floats  # (P, 3)
    reprojection_error_px: Floats  # (P,)
    track_offsets: Ints  # (P + 1,)
    track_cameras: Ints  # (T,) indices into camera_centers_m
    camera_centers_m: Floats  # (M, 3)

    @property
    def track_lengths(self) -> Ints:
        """(P,) number of observing cameras per point."""
        return np.diff(self.track_offsets)

    def select(self, keep: Ints) -> BoxPoints:
        """The points ``keep``, in that order."""
        lengths = self.track_lengths[keep]
        offsets = np.concatenate([[0], np.cumsum(lengths)]).astype(np.int64)
        # Position of every kept observation in the full list: start of its point's track + rank within it.
        place = np.arange(offsets[-1]) + np.repeat(self.track_offsets[keep] - offsets[:-1], lengths)
        return BoxPoints(
            self.points_m[keep],
            self.reprojection_error_px[keep],
            offsets,
            self.track_cameras[place],
            self.camera_centers_m,
        )

    def longest_first(self) -> Ints:
        """(P,) the points by falling track length; of equals, the earlier first."""
        lengths = self.track_lengths
        # Short integers are sorted by counting, four times faster.
        if lengths.max(initial=0) <= np.iinfo(np.int16).max:
            lengths = lengths.astype(np.int16)
        return np.argsort(-lengths, kind="stable")


def box_points(model: SparseModel, config: MissionConfig) -> BoxPoints:
    """Points within ``shared.box_half_extent_m`` of the target on every axis, with long enough tracks."""
    offset = np.abs(model.points_m - config.target_m)
    near = np.maximum(np.maximum(offset[:, 0], offset[:, 1]), offset[:, 2]) <= config.shared.box_half_extent_m
    keep = np.flatnonzero(near & (model.track_lengths >= config.shared.min_track_length))
    everything = BoxPoints(
        model.points_m,
        model.reprojection_error_px,
        model.track_offsets,
        model.track_cameras,
        model.camera_centers_m,
    )
    return everything if len(keep) == len(model.points_m) else everything.select(keep)
