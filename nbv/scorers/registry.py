"""Rankings by scorer: `Rankings` is what the mission asks for."""

from __future__ import annotations

from nbv.config import SCORERS, MissionConfig
from nbv.scorers.b_aware import B_AWARE
from nbv.scorers.covis import COVIS
from nbv.scorers.predicted import PREDICTED
from nbv.scorers.prediction import Prediction
from nbv.scorers.scorer import shared_terms
from nbv.types import CandidatePool, PlanningState, Ranking

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
