"""On new rocks the default runs beside every proposal, so that a gain is not confused with an easy rock."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from tuner.problem.observations import Block, Observation, Proposal, configuration_key
from tuner.samplers.base import (
    VERIFICATION_BEGINS,
    Sampler,
    SamplerSettings,
    ask_many,
    in_flight,
    missions_asked,
)


@dataclass(frozen=True)
class BesideDefault:
    """``inner``, with the default on every rock that it has run, until favourites are verified."""

    inner: Sampler
    settings: SamplerSettings

    @property
    def name(self) -> str:
        """That of ``inner``."""
        return self.inner.name

    def ask(self, history: Sequence[Observation], pending: Sequence[Observation]) -> Proposal:
        """Propose the default where it is missing, else what ``inner`` proposes."""
        return self.ask_many(history, pending, 1)[0]

    def ask_many(
        self, history: Sequence[Observation], pending: Sequence[Observation], count: int
    ) -> list[Proposal]:
        """Return ``count`` proposals, each knowing those before."""
        s, proposals, running = self.settings, list[Proposal](), list(pending)
        while len(proposals) < count:
            missing = self._without_default([*history, *running])
            if missing is None:
                left = count - len(proposals)
                found = ask_many(self.inner, s, history, running, (left + 1) // 2)
            else:
                instance, replicate = missing
                metadata = {"sampler": self.name, "phase": "beside the default"}
                found = [
                    Proposal(
                        dict(s.default), metadata, instance.rock, replicate, condition=instance.condition
                    )
                ]
            for proposal in found:
                running.append(in_flight(s, history, running, proposal))
            proposals += found
        return proposals

    def _without_default(self, missions: Sequence[Observation]) -> Block | None:
        """Return the first block on which the default is missing; None after verification has begun."""
        s = self.settings
        if s.budget is not None and missions_asked(missions, ()) >= VERIFICATION_BEGINS * s.budget:
            return None
        default = configuration_key(s.space, s.default)
        evaluated: dict[Block, bool] = {}
        for m in missions:
            block = (m.instance, m.replicate)
            evaluated[block] = evaluated.get(block, False) or configuration_key(s.space, m.values) == default
        return next((block for block, has in evaluated.items() if not has), None)
