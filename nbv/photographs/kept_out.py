"""Photographs that no mission may take and the reference is not made of: what a mission's model is to predict."""

from __future__ import annotations

from collections.abc import Mapping

from nbv.photographs.photograph_set import PhotographSet
from nbv.random_streams import keyed_rng

SHARE = 0.1  # of the registered photographs


def drawn_out(sha256: Mapping[str, str]) -> frozenset[str]:
    """`SHARE` of the names of photographs, drawn by their content (SHA-256 of the user's file)."""
    rank = {name: keyed_rng("photographs-kept-out", content).random() for name, content in sha256.items()}
    count = round(SHARE * len(rank))
    return frozenset(sorted(rank, key=lambda name: (rank[name], name))[:count])


def kept_out(photographs: PhotographSet) -> frozenset[str]:
    """Names of the photographs of a set that are kept out."""
    return drawn_out({p.name: p.sha256 for p in photographs.registered})
