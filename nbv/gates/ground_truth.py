"""What the oracle gates know: the true surface, and what of it is already covered.

GROUND TRUTH. Nothing in this file is deployable; only the oracle gates use it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from nbv.config import MissionConfig
from nbv.geometry.frames import directions_from
from nbv.geometry.mesh import RayCaster, sample_surface
from nbv.geometry.visibility import (
    MATCHABLE_MAX_INCIDENCE_DEG,
    SURFACE_OFFSET_M,
    in_frustum,
    seen_from,
    usable_cosines,
)
from nbv.types import Bools, Floats, PlanningState

SAMPLE_SEED = 42
GROUND_Z_M = 0.0  # samples below are buried
NEEDED_VIEWS = 3  # that match at a sample, for it to be covered under "matchable"


@dataclass(frozen=True)
class Coverage:
    """Which samples are covered in one state, and how many views of the others can be matched."""

    covered: Bools  # (S,)
    visited_m: Floats  # (V, 3); used by "matchable" only
    partners: NDArray[np.int16] | None = None  # (V, S), "matchable" only


class GroundTruthOracle:
    """Surface samples of the true mesh, what a view really sees of them, and what is covered.

    Parameters
    ----------
    vertices_m, faces
        (V, 3) in the world frame and (F, 3), outward winding: the rock as placed in the scene.
    config
        Its ``gate.oracle_*``, ``camera``, ``target_m`` and, for the angle at which two views can be
        matched, ``dense.min_pair_angle_deg`` and ``dense.max_pair_angle_deg``.

    Coverage (``gate.oracle_coverage``)
    -----------------------------------
    reconstruction
        The paper's text: a reconstructed (sparse) point lies within ``oracle_threshold_m``.
    matchable
        A visited viewpoint sees it together with `NEEDED_VIEWS` - 1 others, each at a matchable angle to it as seen from
        the sample: what dense stereo with so many agreeing views needs.
    paper-code
        What the authors' public code computes, with the mesh where it should be: seen by a visited
        viewpoint, and "seen" means inside the frustum. The first seed covers everything.

    "Sees" is, except in paper-code: in the image of the commanded view, front side within 75 degrees of
    incidence, above ground, and the ray not blocked by the mesh. Answers per viewpoint are kept, since
    the same candidates come back at every iteration.
    """

    def __init__(self, vertices_m: Floats, faces: NDArray[np.integer], config: MissionConfig) -> None:
        from nbv.evaluation.ground_truth import measured_faces  # noqa: PLC0415  a vehicle does not carry it

        self.config = config
        measured = measured_faces(vertices_m, np.asarray(faces, dtype=np.int64), config.evaluation)
        self.samples_m, self.normals = sample_surface(
            vertices_m, measured, config.gate.oracle_samples, SAMPLE_SEED
        )
        self._starts_m = self.samples_m + SURFACE_OFFSET_M * self.normals
        self._caster = RayCaster(vertices_m, faces)
        self._seen: dict[tuple[float, ...], Bools] = {}
        # Of the views that were asked for last, whose list grows by one an iteration.
        self._partners = np.empty((0, 3)), np.empty((0, len(self.samples_m)), np.int16)

    # -- what a view sees

    def visible(self, position_m: Floats) -> Bools:
        """(S,) samples seen by the camera at ``position_m`` aimed at the target."""
        key = tuple(float(v) for v in np.round(position_m, 6))
        if (known := self._seen.get(key)) is not None:
            return known
        position, target_m = np.asarray(position_m, dtype=float), np.array(self.config.target_m)
        seen: Bools = in_frustum(self.samples_m, position[None], target_m, self.config.camera)[:, 0]
        if self.config.gate.oracle_coverage != "paper-code":
            seen &= self.samples_m[:, 2] > GROUND_Z_M
            ask = np.flatnonzero(seen)
            seen[ask] = seen_from(
                position, self._starts_m[ask], self.normals[ask], self._caster, MATCHABLE_MAX_INCIDENCE_DEG
            )
        self._seen[key] = seen
        return seen

    # -- what is covered

    def coverage(self, state: PlanningState) -> Coverage:
        """Which samples of the true surface the visited viewpoints cover."""
        mode = self.config.gate.oracle_coverage
        visited = np.asarray(state.visited_m, dtype=float).reshape(-1, 3)
        if mode == "reconstruction":
            limit = self.config.gate.oracle_threshold_m
            low, high = self.samples_m.min(axis=0) - limit, self.samples_m.max(axis=0) + limit
            points = state.model.points_m
            points = points[((points >= low) & (points <= high)).all(axis=1)]
            if len(points) == 0:
                return Coverage(np.zeros(len(self.samples_m), dtype=bool), visited)
            tree = scipy.spatial.cKDTree(points)
            distance, _ = tree.query(self.samples_m, distance_upper_bound=limit * (1 + 1e-12))
            return Coverage(distance <= limit, visited)
        if mode == "matchable":
            partners = self._matchable_partners(visited)
            return Coverage(_matchable_views(partners) >= NEEDED_VIEWS, visited, partners)
        covered = np.zeros(len(self.samples_m), dtype=bool)
        for position in visited:
            covered |= self.visible(position)
        return Coverage(covered, visited)

    def _pairs(
        self, position_m: Floats, rows: NDArray[np.integer], others_m: Floats, partners: NDArray[np.int16]
    ) -> Bools:
        """(V, R) which of the other views (V, 3) match one from ``position_m`` at the samples ``rows`` that it sees.

        ``partners`` (V, R) says which of them the others see.
        """
        mine = directions_from(self.samples_m[rows], position_m)
        pairs = np.zeros(partners.shape, dtype=bool)
        for v, other in enumerate(others_m):
            both = np.flatnonzero(partners[v] >= 0)
            theirs = directions_from(self.samples_m[rows[both]], other)
            cosine = np.einsum("ij,ij->i", mine[both], theirs)
            pairs[v, both] = usable_cosines(cosine, self.config.dense)
        return pairs

    def _matchable_partners(self, visited_m: Floats) -> NDArray[np.int16]:
        """(V, S): -1 where a view does not see a sample, else how many others see it at a matchable angle."""
        known, counts = self._partners
        done = len(known) if np.array_equal(known, visited_m[: len(known)]) else 0
        partners = np.full((len(visited_m), len(self.samples_m)), -1, dtype=np.int16)
        partners[:done] = counts[:done]
        for v in range(done, len(visited_m)):
            seen = np.flatnonzero(self.visible(visited_m[v]))
            pairs = self._pairs(visited_m[v], seen, visited_m[:v], partners[:v, seen])
            partners[:v, seen] += pairs
            partners[v, seen] = pairs.sum(axis=0)
        self._partners = (visited_m.copy(), partners.copy())
        return partners

    # -- what a candidate would bring

    def gain(self, position_m: Floats, coverage: Coverage) -> float:
        """Uncovered samples that a view from ``position_m`` really sees.

        With "matchable" coverage one more view rarely completes a sample, and one that no visited view
        can be matched with helps nothing, so the gain is progress instead: over the uncovered samples,
        the growth of (matchable views so far / views needed).
        """
        visible = self.visible(position_m) & ~coverage.covered
        if coverage.partners is None:
            return float(np.count_nonzero(visible))
        rows = np.flatnonzero(visible)
        before = coverage.partners[:, rows]
        pairs = self._pairs(position_m, rows, coverage.visited_m, before)
        after = np.maximum(_matchable_views(before + pairs), pairs.sum(axis=0) + 1)
        growth = np.minimum(after, NEEDED_VIEWS) - np.minimum(_matchable_views(before), NEEDED_VIEWS)
        return float(growth.sum()) / NEEDED_VIEWS


def _matchable_views(partners: NDArray[np.int16]) -> NDArray[np.int16]:
    """(S,) views of each sample that can be matched: those of its best view, itself and its partners (V, S)."""
    views: NDArray[np.int16] = partners.max(axis=0, initial=-1) + 1
    return views
