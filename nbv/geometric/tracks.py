"""Feature tracks without images: which views' detections of a landmark end up in one sparse point.

Detections of one landmark in two views match when their lines of sight differ little enough; a track is a
connected set of matching detections, as in COLMAP. A landmark may have several tracks (seen from opposite
sides, say), and each is a point of its new.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from nbv.types import Floats, Floats32, Ints


class Tracks:
    """Detections and their grouping, view by view; L landmarks, at most ``capacity`` views.

    ``cosine_limit`` (L,) is the smallest cosine between two lines of sight that still match, per landmark.
    """

    def __init__(self, cosine_limit: Floats | Floats32, capacity: int) -> None:
        self._cosine_limit = cosine_limit.astype(np.float32)
        self.n_views = 0
        self._directions = np.zeros((capacity, len(cosine_limit), 3), dtype=np.float32)
        # The number of a view in the track, or -1: which one is arbitrary, equal numbers are one track.
        # A row per landmark, since tracks are listed landmark by landmark.
        self._labels = np.full((len(cosine_limit), capacity), -1, dtype=np.int16)

    def copy(self, capacity: int) -> Tracks:
        """The same tracks with room for ``capacity`` views."""
        other = Tracks(self._cosine_limit, capacity)
        other.n_views = n = self.n_views
        other._directions[:n] = self._directions[:n]
        other._labels[:, :n] = self._labels[:, :n]
        return other

    def add(
        self, landmarks: Ints, directions: NDArray[np.floating], needed: int = 0, point_views: int = 1
    ) -> int:
        """Add a view: the landmarks (K,) that it detects, and unit directions (K, 3) from them to the camera.

        Returns its matches, detections that match one of a point; a point takes ``point_views`` views, once there are as many. A
        view with fewer matches than ``needed`` is not added.
        """
        m, capacity = self.n_views, self._labels.shape[1]
        here = directions.astype(np.float32, copy=False)
        # All earlier detections of these landmarks: which of the new ones (0 to K - 1), in which view, in which track.
        before = self._labels.take(landmarks, axis=0).ravel()
        index = np.flatnonzero(before >= 0)
        new = index // capacity
        view = index - new * capacity
        track = before[index].astype(np.int64)
        cosine = np.einsum("ij,ij->i", self.directions_of(view, landmarks[new]), here.take(new, axis=0))
        linked = cosine >= self._cosine_limit[landmarks][new]
        joined = np.zeros((m + 1, len(landmarks)), dtype=bool)  # [track, new detection]; row m stays False
        joined[track[linked], new[linked]] = True
        lengths = np.bincount(track * len(landmarks) + new, minlength=joined.size).reshape(joined.shape)
        matches = int((joined & (lengths >= min(point_views, m))).any(axis=0).sum())
        if matches < needed:
            return matches
        self.n_views = m + 1
        self._directions[m, landmarks] = here
        label = np.where(joined.any(axis=0), joined.argmax(axis=0), m)
        # Where this view joins several tracks, they become one.
        merged = joined[track, new]
        self._labels[landmarks[new[merged]], view[merged]] = label[new[merged]]
        self._labels[landmarks, m] = label
        return matches

    def shared(self) -> Ints:
        """(V, V) landmarks that two views detect and match with each other directly."""
        counts = np.zeros((self.n_views, self.n_views), dtype=np.int64)
        detected = self._labels[:, : self.n_views] >= 0
        for a in range(self.n_views):
            for b in range(a):
                both = np.flatnonzero(detected[:, a] & detected[:, b])
                cosine = np.einsum("ij,ij->i", self._directions[a, both], self._directions[b, both])
                counts[a, b] = counts[b, a] = np.count_nonzero(cosine >= self._cosine_limit[both])
        return counts

    def directions_of(self, views: Ints, landmarks: Ints) -> Floats32:
        """(T, 3) directions from landmarks to cameras, ``directions[views, landmarks]`` in a third of the time."""
        flat = self._directions.reshape(-1, 3)
        return flat.take(views * self._directions.shape[1] + landmarks, axis=0)

    def points(self, min_views: int) -> tuple[Ints, Ints, Ints]:
        """Tracks of at least ``min_views`` views: their landmarks (P,), offsets (P + 1,), views (T,) (CSR)."""
        count, capacity = self._labels.shape
        # Small integers sort and divide several times faster, np.floor_divide faster than np.divmod.
        small = np.int32 if count * capacity * capacity <= np.iinfo(np.int32).max else np.int64
        labels = self._labels.ravel()
        index: Ints = np.flatnonzero(labels >= 0)
        label = labels.take(index)
        index = index.astype(small)
        view = index % capacity
        key = (index - view + label) * capacity + view
        # By landmark, track, view. Most landmarks have one track, so nearly in order: a merge sort is fast on that.
        key.sort(kind="stable")
        track = key // capacity
        view = key - track * capacity
        first = np.flatnonzero(np.concatenate([[True], track[1:] != track[:-1]])) if len(key) else key
        length = np.diff(np.append(first, len(key)))
        long = length >= min_views
        keep = np.repeat(long, length)
        offsets = np.concatenate([[0], np.cumsum(length[long])]).astype(np.int64)
        return (track[first[long]] // capacity).astype(np.int64), offsets, view[keep].astype(np.int64)
