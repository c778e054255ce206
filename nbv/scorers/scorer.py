"""Eq. 1: what a scorer is, and the complete ranking that it makes of a pool."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from nbv.config import MissionConfig, Weights
from nbv.scorers.shared import SharedTerms
from nbv.types import CandidatePool, Floats, Ints, Ranking


@dataclass(frozen=True)
class Scorer:
    """A main term of its own with its weights; novelty, movement and angular penalty are shared.

    Parameters
    ----------
    name
        In `nbv.config.registry`, in rankings and traces, and as ``gate.kind``.
    main_term
        From the shared terms, the pool and the configuration: (C,), in [0, 1] for weights to mean the same.
    weights
        Which of the configuration's weights are the scorer's.
    """

    name: str
    main_term: Callable[[SharedTerms, CandidatePool, MissionConfig], Floats]
    weights: Callable[[MissionConfig], Weights]

    def rank(self, terms: SharedTerms, pool: CandidatePool, config: MissionConfig) -> Ranking:
        """All candidates by falling score; ties keep pool order."""
        main = self.main_term(terms, pool, config)
        scores = eq_1(main, terms, self.weights(config))
        unweighted = {"main": main, "nov": terms.nov, "move": terms.move, "ang": terms.ang}
        return Ranking(self.name, falling(scores), scores, unweighted)


def eq_1(main: Floats, terms: SharedTerms, weights: Weights) -> Floats:
    """(C,) S(c)."""
    return weights.main * main + weights.nov * terms.nov - weights.move * terms.move - weights.ang * terms.ang


def falling(scores: Floats) -> Ints:
    """(C,) candidates, best first; ties keep pool order."""
    # Symmetric candidates tie up to rounding, which differs between processors: 1e-12 is no preference.
    return np.argsort(-np.round(scores, 12), kind="stable").astype(np.int64)
