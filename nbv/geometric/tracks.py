"""Feature tracks without images: which views' detections of a landmark end up in one sparse point.

Detections of one landmark in two views match when their lines of sight differ little enough; a track is a
connected set of matching detections, as in COLMAP. A landmark may have several tracks (seen from opposite
sides, say), and each is a point of its own.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from nbv.types import Floats, Ints

Mask = NDArray[np.bool_]


class Tracks:
    """Detections and their grouping, view by view; L landmarks, at most ``capacity`` views.

    Parameters
    ----------
    cosine_limit
        (L,) smallest cosine between two lines of sight that still match, per landmark.
    """

    def __init__(self, cosine_limit: Floats, capacity: int) -> None:
        self._cosine_limit = cosine_limit.astype(np.float32)
        self.n_views = 0
        self.directions = np.zeros((capacity, len(cosine_limit), 3), dtype=np.float32)
        # The number of a view in the track, or -1: which one is arbitrary, equal numbers are one track.
        self.labels = np.full((capacity, len(cosine_limit)), -1, dtype=np.int16)

    def copy(self, capacity: int) -> Tracks:
        """The same tracks with room for ``capacity`` views."""
        other = Tracks.__new__(Tracks)
        other._cosine_limit, other.n_views = self._cosine_limit, self.n_views
        n = self.n_views
        other.directions = np.empty((capacity, *self.directions.shape[1:]), dtype=np.float32)
        other.directions[:n] = self.directions[:n]
        other.labels = np.full((capacity, self.labels.shape[1]), -1, dtype=np.int16)
        other.labels[:n] = self.labels[:n]
        return other

    def add(self, directions: Floats, detected: Mask) -> int:
        """Add a view: unit directions (L, 3) from landmark to camera, detections (L,). Returns its matches.

        The number of matches counts landmarks whose detection here joins an earlier view's.
        """
        m = self.n_views
        self.n_views = m + 1
        columns = np.flatnonzero(detected)
        here = directions[columns].astype(np.float32)
        self.directions[m, columns] = here
        before = self.labels[:m, columns]
        cosine = np.einsum("mnk,nk->mn", self.directions[:m].take(columns, axis=1), here)
        linked = (before >= 0) & (cosine >= self._cosine_limit[columns])
        view, column = np.nonzero(linked)
        joined = np.zeros((m + 1, len(columns)), dtype=bool)  # [label, column]; row m stays False
        joined[before[view, column], column] = True
        matched = joined.any(axis=0)
        self.labels[m, columns] = np.where(matched, joined.argmax(axis=0), m)
        if m:
            # joined[before, column], but several times faster; label -1 reads row m, from the end
            member = joined.ravel().take(before * np.int64(len(columns)) + np.arange(len(columns)))
            merged = np.where(member, self.labels[m, columns][None], before)
            self.labels[:m, columns] = merged
        return int(matched.sum())

    def directions_of(self, views: Ints, landmarks: Ints) -> NDArray[np.float32]:
        """(T, 3) directions from landmarks to cameras, ``directions[views, landmarks]`` in a third of the time."""
        return self.directions.reshape(-1, 3).take(views * self.directions.shape[1] + landmarks, axis=0)

    def points(self, min_views: int) -> tuple[Ints, Ints, Ints]:
        """Tracks of at least ``min_views`` views: their landmarks (P,), offsets (P + 1,), views (T,) (CSR)."""
        n = self.n_views
        count = self.labels.shape[1]
        # Small integers sort and divide several times faster, np.floor_divide faster than np.divmod.
        small = np.int32 if count * n * n <= np.iinfo(np.int32).max else np.int64
        labels = self.labels[:n].ravel()
        place: Ints = np.flatnonzero(labels >= 0).astype(small)
        view: Ints = place // count
        key = ((place - view * count) * n + labels[place]) * n + view
        key.sort()  # by landmark, track, view
        track = key // n
        view = key - track * n
        first = np.flatnonzero(np.concatenate([[True], track[1:] != track[:-1]])) if len(key) else key
        length = np.diff(np.append(first, len(key)))
        long = length >= min_views
        keep = np.repeat(long, length)
        offsets = np.concatenate([[0], np.cumsum(length[long])]).astype(np.int64)
        return (track[first[long]] // n).astype(np.int64), offsets, view[keep].astype(np.int64)
