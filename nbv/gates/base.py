"""What a gate is: it reads the state and returns one ranking, unchanged (a hard switch), whose best view is taken."""

from __future__ import annotations

import copy
import hashlib
from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np

from nbv.config import MissionConfig
from nbv.gates.ground_truth import GroundTruthOracle
from nbv.process import keyed_rng
from nbv.scorers import COVIS
from nbv.scorers.scorer import argsort_descending
from nbv.types import CandidatePool, Floats, GateDecision, PlanningState, Ranking


@dataclass
class Gate(ABC):
    """Chooses the ranking whose best view is taken.

    A control or a planner of its own returns a ranking that is not among those given, under its own name, so that
    the mission loop is the same for all. A plug-in's gate draws by `rng`, a built-in one from a stream keyed by rock, replicate
    and iteration.

    Parameters
    ----------
    config
        The vehicle's; the gate's own settings are in its ``gate``.
    rock_sha256
        Which rock it is, for the draws of built-in gates; a plug-in is not told.
    oracle
        The ground truth, for a gate that says ``sees_ground_truth``, and for no other.
    """

    sees_ground_truth: ClassVar[bool] = False  # True: an upper reference, not deployable
    settings: ClassVar[type | None] = None  # of a plug-in: a frozen dataclass, ``config.NAME`` has them

    config: MissionConfig
    rock_sha256: str = ""
    replicate: int = 0
    oracle: GroundTruthOracle | None = None

    @property
    def truth(self) -> GroundTruthOracle:
        if self.oracle is None:
            raise ValueError("a gate that reads the ground truth must say sees_ground_truth = True")
        return self.oracle

    def rng(self, state: PlanningState) -> np.random.Generator:
        """A generator for one decision, keyed by gate, sparse model, replicate and iteration."""
        seen = hashlib.sha256(state.model.points_m.tobytes()).hexdigest()
        return keyed_rng(self.config.gate.kind, seen, self.replicate, state.iteration)

    def recentred(self, config: MissionConfig) -> Self:
        """A copy of this gate for ``config``, whose ``target_m`` is where the mission has found the target."""
        other = copy.copy(self)
        other.config = config
        return other

    @abstractmethod
    def decide(self, state: PlanningState, pool: CandidatePool, rankings: dict[str, Ranking]) -> GateDecision:
        """The decision for one iteration; ``pool`` is never empty.

        ``rankings["covis"]`` and ``rankings["b-aware"]`` are there, any other scorer's ranking is made when it is asked for
        (`nbv.scorers.registry.Rankings`).
        """


def ranking_of(name: str, scores: Floats, rankings: dict[str, Ranking]) -> Ranking:
    """A ranking by ``scores`` (C,); ties keep pool order. Its main term is the score itself."""
    shared = rankings[COVIS.name].terms  # as in any ranking
    return Ranking(name, argsort_descending(scores), scores, {**shared, "main": scores})
