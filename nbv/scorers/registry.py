"""Rankings by scorer: `rank_candidates` is what the mission calls."""

from __future__ import annotations

from nbv.config import SCORERS, MissionConfig
from nbv.plugins import read_only
from nbv.scorers.b_aware import B_AWARE
from nbv.scorers.covis import COVIS
from nbv.scorers.predicted import PREDICTED
from nbv.scorers.prediction import Prediction
from nbv.scorers.scorer import SharedTerms, shared_terms
from nbv.types import CandidatePool, PlanningState, Ranking

BUILT_IN = {scorer.name: scorer for scorer in (COVIS, B_AWARE, PREDICTED)}
# Ranked in every mission, whatever its gate: the traces say what either would have chosen.
PAPER_SCORERS = (COVIS.name, B_AWARE.name)


class Rankings(dict[str, Ranking]):
    """One pool's rankings by scorer: the paper's two, and any other as soon as it is asked for by name.

    `UserError` for a name that no scorer has; `MissionFailure` for a scorer that the state gives nothing to work with.
    """

    def __init__(self, terms: SharedTerms, pool: CandidatePool, config: MissionConfig) -> None:
        super().__init__()
        self._terms, self._pool, self._config = terms, pool, config
        for name in PAPER_SCORERS:
            self[name]

    def __missing__(self, name: str) -> Ranking:
        scorer = SCORERS.load(name, BUILT_IN)
        ranking = self[name] = read_only(scorer.rank(self._terms, self._pool, self._config))
        return ranking


def rank_candidates(
    state: PlanningState,
    pool: CandidatePool,
    config: MissionConfig,
    prediction: Prediction | None = None,
) -> Rankings:
    """Rankings of the same pool by scorer: ``covis``, ``b-aware``, others on demand.

    The pool must not be empty; the mission ends before scoring if it is.
    """
    if len(pool) == 0:
        raise ValueError("rank_candidates: the candidate pool is empty")
    return Rankings(shared_terms(state, pool, config, prediction), pool, config)
