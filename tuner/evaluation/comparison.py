"""Strategies against each other: means with intervals, and paired differences on common missions."""

from __future__ import annotations

import collections
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from nbv.errors import UserError
from tuner.evaluation.paper_table import TABLE_I_ROWS, MetricRow
from tuner.evaluation.statistics import Interval, PairedDifference, mean_interval, paired_difference
from tuner.missions.job import Trial


def values_of(records: Sequence[Trial], strategy: str, key: str) -> dict[tuple[str, int], float]:
    """A metric by (rock, replicate), failed missions left out.

    Where there are several conditions the replicates of the second are numbered on from those of the first.
    """
    found = {}
    conditions = sorted({r.condition for r in records})
    span = 1 + max((r.replicate for r in records), default=0)
    for r in records:
        value = r.value(key) if r.strategy == strategy else None
        if value is not None:
            found[r.rock, span * conditions.index(r.condition) + r.replicate] = value
    return found


def strategy_interval(records: Sequence[Trial], strategy: str, key: str) -> Interval | None:
    """Mean over rocks with its interval."""
    by_rock: dict[str, list[float]] = {}
    for (rock, _), value in values_of(records, strategy, key).items():
        by_rock.setdefault(rock, []).append(value)
    return mean_interval(by_rock)


def strategy_difference(
    records: Sequence[Trial],
    strategy: str,
    reference: str,
    row: MetricRow,
) -> PairedDifference | None:
    """Paired difference of a metric against ``reference`` on common (rock, replicate) pairs."""
    ours, theirs = (values_of(records, name, row.key) for name in (strategy, reference))
    return paired_difference(ours, theirs, row.higher_is_better)


def rock_floor(records: Sequence[Trial], metric: MetricRow) -> float | None:
    """Mean over rocks of what a perfect reconstruction would get (``nbv.evaluation.floor``).

    A property of the rocks, so missions of all strategies may tell it. None where no mission holds it.
    """
    by_rock: dict[str, float] = {}
    for r in records:
        value = r.value(metric.floor_key)
        if value is not None:
            by_rock[r.rock] = value
    return sum(by_rock.values()) / len(by_rock) if by_rock else None


@dataclass(frozen=True)
class ComparisonRow:
    """One metric across the strategies."""

    metric: MetricRow
    cells: dict[str, Interval | None]  # by strategy
    best: tuple[str, ...]  # strategies with the best mean (several when equal)
    floor: float | None  # what a perfect reconstruction would get, mean over rocks; None for most metrics
    differences: dict[str, PairedDifference | None]  # against the reference, which is left out


@dataclass(frozen=True)
class ComparisonTable:
    """A table in the layout of the paper's Table I, with intervals and paired differences."""

    strategies: tuple[str, ...]
    reference: str | None
    rows: list[ComparisonRow]
    missions: dict[str, int]  # with metrics, by strategy
    failures: dict[str, int]  # failed missions, by strategy


def comparison_table(
    records: Sequence[Trial],
    strategies: Sequence[str],
    reference: str | None = None,
    surface: Literal["whole", "observable"] | None = "whole",
    rows: Sequence[MetricRow] = TABLE_I_ROWS,
) -> ComparisonTable:
    """Means with intervals per strategy, and differences against ``reference`` (one of the strategies).

    ``surface``: on which the ``rows`` are measured; None: as they say themselves.

    Raises
    ------
    UserError
        The reference is none of the strategies.
    """
    if reference is not None and reference not in strategies:
        raise UserError(f"reference {reference!r} was not evaluated; choose from {', '.join(strategies)}")
    table = []
    for row in rows:
        metric = row if surface is None or row.key.startswith("costs.") else row.on(surface)
        cells = {name: strategy_interval(records, name, metric.key) for name in strategies}
        means = {name: cell.mean for name, cell in cells.items() if cell is not None}
        pick = max if metric.higher_is_better else min
        best = tuple(name for name, mean in means.items() if mean == pick(means.values())) if means else ()
        differences = {
            name: strategy_difference(records, name, reference, metric)
            for name in strategies
            if reference is not None and name != reference
        }
        table.append(ComparisonRow(metric, cells, best, rock_floor(records, metric), differences))
    counts = collections.Counter(r.strategy for r in records if r.status != "failed")
    failures = collections.Counter(r.strategy for r in records if r.status == "failed")
    return ComparisonTable(
        tuple(strategies),
        reference,
        table,
        {name: counts[name] for name in strategies},
        {name: failures[name] for name in strategies},
    )
