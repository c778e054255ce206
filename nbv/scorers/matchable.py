"""Matchable repair: how much of the surface a candidate would bring closer to dense reconstruction.

Eq. 8 asks which *sparse points* are weak. Dense stereo reconstructs *surface*, and only where enough views see it
at angles that can be matched. So this term closes the sparse points into a surface (their convex hull: the parts
that no photograph has matched yet exist on it, too) and counts, for samples of it, the views that see them at a
matchable angle to one another. Deployable: it reads the sparse model and the visited viewpoints only.
It is not in the paper.
"""

from __future__ import annotations

import numpy as np

from nbv.config import MissionConfig
from nbv.geometry.matchability import matchable_views, matchable_views_with, partners, usable_cosines
from nbv.scorers.scorer import Scorer, SharedTerms
from nbv.scorers.surface import ProxySurface, proxy_surface, sees
from nbv.types import Bools, CandidatePool, Floats, Floats32

BLOCK = 64  # samples at a time: a block's (BLOCK, C, V) arrays stay in the processor's cache


def expected_gain_percent(
    points_m: Floats, candidate_m: Floats, visited_m: Floats, config: MissionConfig
) -> float:
    """Of all matchable views that the surface estimated from sparse points (N, 3) needs, the share (%) that one more view would add.

    The view is from ``candidate_m`` (3,), those so far from ``visited_m`` (V, 3).
    """
    surface = proxy_surface(points_m, config)
    gained, _ = views_gained(surface, candidate_m.reshape(1, 3), visited_m, config)
    return 100.0 * float(gained[0]) / (len(surface.samples_m) * config.matchable.views)


def views_gained(
    surface: ProxySurface, candidates_m: Floats, visited_m: Floats, config: MissionConfig
) -> tuple[Floats, int]:
    """(C,) matchable views that each candidate (C, 3) would add to those visited (V, 3) over all samples, and how many are missing.

    What a sample has is counted in `nbv.geometry.matchability`; it needs ``matchable.views``.
    """
    need = config.matchable.views
    n_visited = len(visited_m)
    views = np.concatenate([visited_m.reshape(-1, 3), candidates_m])
    visible = sees(surface, views, config)
    gained = np.zeros(len(candidates_m))
    missing = 0
    for start in range(0, len(surface.samples_m), BLOCK):
        samples, seen = surface.samples_m[start : start + BLOCK], visible[start : start + BLOCK]
        have = partners(_pairs(samples, visited_m, visited_m, config), seen[:, :n_visited])
        before = np.minimum(matchable_views(have), need)  # (S,)
        lacks = before < need
        if not lacks.any():
            continue
        samples, seen, have, before = samples[lacks], seen[lacks], have[lacks], before[lacks]
        new = _pairs(samples, candidates_m, visited_m, config)  # (S, C, V)
        new &= seen[:, n_visited:, None] & seen[:, None, :n_visited]
        after = np.minimum(matchable_views_with(have, new, seen[:, n_visited:]), need)  # (S, C)
        gained += (after - before[:, None]).sum(axis=0)
        missing += int((need - before).sum())
    return gained, missing


def _pairs(samples_m: Floats, a_m: Floats, b_m: Floats, config: MissionConfig) -> Bools:
    """(S, A, B): can two views be matched, as seen from a sample?"""

    def directions(positions_m: Floats) -> Floats32:
        delta = (positions_m.reshape(1, -1, 3) - samples_m[:, None]).astype(np.float32)
        delta /= np.sqrt(np.einsum("snk,snk->sn", delta, delta))[:, :, None]
        return delta

    return usable_cosines(directions(a_m) @ directions(b_m).transpose(0, 2, 1), config.dense)


def matchable_repair(terms: SharedTerms, pool: CandidatePool, config: MissionConfig) -> Floats:
    """(C,) share of all matchable views still missing that each candidate would add, in [0, 1]; zeros where none is."""
    surface = proxy_surface(terms.box.points_m, config)
    gained, missing = views_gained(surface, pool.positions_m, terms.visited_m, config)
    return gained / max(missing, 1)


MATCHABLE = Scorer("matchable", matchable_repair, weights=lambda config: config.matchable.weights)
