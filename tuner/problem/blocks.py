"""On which (rock, replicate) block a configuration flies."""

from __future__ import annotations

import collections
from collections.abc import Mapping, Sequence
from typing import Any, Protocol

from tuner.problem.observations import Proposal


class Mission(Protocol):
    """What a block is chosen by: a ledger's trial, an observation or a pending mission."""

    @property
    def values(self) -> Mapping[str, Any]:
        """Tuned parameters."""
        ...

    @property
    def rock(self) -> str:
        """Name or mesh file."""
        ...

    @property
    def replicate(self) -> int:
        """Number of the draw."""
        ...


def next_block(
    rocks: Sequence[str], replicates: int, missions: Sequence[Mission], proposal: Proposal
) -> tuple[str, int]:
    """Rock and replicate of the next mission, where the sampler left them open.

    The rock visited least (ties: list order), so rocks are taken in turn; on it the replicate used least among
    those this configuration has not flown there. A configuration that has flown them all gets a fresh number.
    """
    visits = collections.Counter(t.rock for t in missions)
    rock = proposal.rock if proposal.rock is not None else min(rocks, key=lambda name: visits[name])
    if proposal.replicate is not None:
        return rock, proposal.replicate
    here = [t for t in missions if t.rock == rock]
    used = collections.Counter(t.replicate for t in here)
    own = {t.replicate for t in here if t.values == proposal.values}
    fresh = [k for k in range(replicates) if k not in own]
    if fresh:
        return rock, min(fresh, key=lambda k: (used[k], k))
    return rock, next(k for k in range(replicates, replicates + len(own) + 1) if k not in own)
