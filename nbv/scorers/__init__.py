"""The scorers: arrays in, rankings out. `Rankings` is what the mission asks for.

A scorer is a main term with weights (`Scorer`); Eq. 1 and the terms that all share are written once. Those that a
configuration may name stand in ``registry``.
"""

from nbv.scorers.registry import COVIS, Rankings
from nbv.scorers.scorer import Scorer, SharedTerms

__all__ = ["COVIS", "Rankings", "Scorer", "SharedTerms"]
