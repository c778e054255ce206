"""What finished missions decided, capture by capture: whose ranking was flown, and which viewpoints."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

from nbv.mission.result import IterationRecord, MissionResult
from nbv.scorers import B_AWARE
from tuner.missions.job import Trial

Block = tuple[str, int]  # (rock, replicate)
Traces = dict[str, dict[Block, list[IterationRecord]]]  # by strategy and block
PERCENT = 100.0


def load_traces(records: Iterable[Trial]) -> Traces:
    """Every finished mission's trace; failed missions are left out. Strategies share missions, read once.

    Raises
    ------
    UserError
        A mission's document cannot be read.
    """
    read: dict[str, list[IterationRecord]] = {}
    traces: Traces = {}
    for r in records:
        if r.status == "failed":
            continue
        directory = r.directory
        if directory not in read:
            read[directory] = MissionResult.load(Path(directory)).trace
        traces.setdefault(r.strategy, {})[r.rock, r.replicate] = read[directory]
    return traces


def b_aware_share(trace: Sequence[IterationRecord]) -> float | None:
    """Percent of the captures that flew B-aware's ranking; None without a capture."""
    if not trace:
        return None
    return PERCENT * sum(record.scorer == B_AWARE.name for record in trace) / len(trace)


def other_views_share(trace: Sequence[IterationRecord], reference: Sequence[IterationRecord]) -> float | None:
    """Jaccard distance in percent of the two missions' chosen viewpoints, whatever their order.

    0 when both photographed from the same viewpoints, 100 when they have none in common; None when neither
    flew a capture.
    """
    ours, theirs = ({record.chosen for record in t} for t in (trace, reference))
    if not ours and not theirs:
        return None
    return PERCENT * (1.0 - len(ours & theirs) / len(ours | theirs))


def same_flight(trace: Sequence[IterationRecord], reference: Sequence[IterationRecord]) -> bool:
    """Whether both chose the same viewpoints in the same order."""
    return [record.chosen for record in trace] == [record.chosen for record in reference]


def by_rock(values: dict[Block, float]) -> dict[str, list[float]]:
    """Values grouped for ``tuner.evaluation.comparison.mean_interval``."""
    grouped: dict[str, list[float]] = {}
    for (rock, _), value in sorted(values.items()):
        grouped.setdefault(rock, []).append(value)
    return grouped


def per_block(
    traces: dict[Block, list[IterationRecord]], measure: Callable[[list[IterationRecord]], float | None]
) -> dict[Block, float]:
    """``measure`` of every mission that has it."""
    return {block: value for block, t in traces.items() if (value := measure(t)) is not None}
