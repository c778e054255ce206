"""What guards the calls of scorers and gates of plug-ins: copies for what they are given, checks for what they return."""

from __future__ import annotations

import contextlib
import copy
import dataclasses
from collections.abc import Iterator
from typing import Any

import msgspec
import numpy as np

from nbv.errors import MissionFailure
from nbv.plugins.importing import error_text, lines_of, shortened
from nbv.types import Floats, GateDecision, Ranking

DETAILS_BYTES = 10_000  # of what a gate says of one decision
MOST_TERMS = 50  # of a ranking


def read_only(value: Any) -> Any:
    """A copy whose arrays nobody can write to, neither from it to ours nor through their ``base``.

    Of an array, or of all arrays in a dataclass, tuple or dictionary; anything else is shared.
    """
    if isinstance(value, np.ndarray) and not value.dtype.hasobject:
        return np.ndarray(value.shape, value.dtype, value.tobytes())
    if isinstance(value, tuple):
        return tuple(map(read_only, value))
    is_dict = isinstance(value, dict)
    if not is_dict and (not dataclasses.is_dataclass(value) or isinstance(value, type)):
        return value
    other = copy.copy(value)
    if is_dict:
        other |= {name: read_only(item) for name, item in value.items()}
    for name, item in vars(value).items() if hasattr(value, "__dict__") else ():
        object.__setattr__(other, name, read_only(item))
    return other


class Guard:
    """Guards one part, which messages call ``label``; its code lies in the package ``package``."""

    def __init__(self, label: str, package: str) -> None:
        self.label, self.package = label, package

    def failure(self, what: str) -> MissionFailure:
        """How the mission ends in which the part did ``what``."""
        return MissionFailure("plugin_failed", shortened(f"{self.label} {what}"))

    def scorer(self, name: str, scorer: Any) -> Any:
        """A scorer called ``name`` that ranks with copies and returns what has been checked."""

        def main_term(terms: Any, pool: Any, config: Any) -> Floats:
            return self._numbers(scorer.main_term(terms, pool, config), len(pool))

        def rank(terms: Any, pool: Any, config: Any) -> Ranking:
            with self._blamed():
                ranking = checked.rank(read_only(terms), read_only(pool), copy.deepcopy(config))
                return self._ranking(ranking, len(pool))

        checked = dataclasses.replace(scorer, name=name, main_term=main_term)
        guarded = copy.copy(checked)
        object.__setattr__(guarded, "rank", rank)  # in place of the method, which may be the plug-in's own
        return guarded

    def gate(self, gate: Any) -> Any:
        """A subclass of a gate's class that decides with copies and returns what has been checked."""

        def decide(gate_self: Any, state: Any, pool: Any, rankings: Any) -> GateDecision:
            with self._blamed():
                decision = gate.decide(gate_self, read_only(state), read_only(pool), read_only(rankings))
                if not isinstance(decision, GateDecision):
                    raise self.failure(f"returned {type(decision).__name__}, no nbv.types.GateDecision")
                ranking = self._ranking(decision.ranking, len(pool))
                details = msgspec.json.encode(decision.details, enc_hook=_plain)
                if len(details) > DETAILS_BYTES:
                    raise self.failure(
                        f"returned details of {len(details)} bytes; at most {DETAILS_BYTES} are kept"
                    )
                return GateDecision(ranking, shortened(str(decision.reason)), msgspec.json.decode(details))

        def recentred(gate_self: Any, config: Any) -> Any:
            other = gate.recentred(gate_self, copy.deepcopy(config))
            if not isinstance(other, guarded):
                raise self.failure(f"became {type(other).__name__} for another target")
            return other

        members = {"decide": decide, "recentred": recentred, "__module__": gate.__module__}
        guarded = type(gate.__name__, (gate,), members)
        return guarded

    @contextlib.contextmanager
    def _blamed(self) -> Iterator[None]:
        """What is raised here, in code of ours, for what the part returned is its failure."""
        try:
            yield
        except MissionFailure:
            raise
        except Exception as error:
            if self.package != "nbv" and self.package in lines_of(error):  # its own code raised: `failure_of`
                raise
            raise self.failure(f"returned what cannot be used: {error_text(error)}") from error

    def _numbers(self, values: Any, count: int) -> Floats:
        """``values`` as (count,) finite numbers; else the mission fails."""
        try:
            array = np.array(values, dtype=float)
        except (TypeError, ValueError):
            array = np.empty(0)
        if array.shape != (count,):
            raise self.failure(
                f"returned the shape {array.shape}, not ({count},): one number for each candidate"
            )
        if bad := int(np.count_nonzero(~np.isfinite(array))):
            raise self.failure(f"returned NaN or infinity for {bad} of {count}")
        return array

    def _ranking(self, ranking: Any, count: int) -> Ranking:
        """What ``ranking`` says, checked, in an object and arrays of our own."""
        scores = self._numbers(ranking.scores, count)
        order = np.array(ranking.order, dtype=np.int64)
        if not np.array_equal(np.sort(order), np.arange(count)):
            raise self.failure("returned an order that is no permutation")
        terms = {
            shortened(str(name)): np.array(values, dtype=float) for name, values in ranking.terms.items()
        }
        if len(terms) > MOST_TERMS or any(values.shape != (count,) for values in terms.values()):
            raise self.failure(f"returned more than {MOST_TERMS} terms, or some not of the shape ({count},)")
        return Ranking(shortened(str(ranking.scorer)), order, scores, terms)


def _plain(value: Any) -> Any:
    return value.tolist() if isinstance(value, (np.ndarray, np.generic)) else shortened(str(value))
