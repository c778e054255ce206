"""What an evaluation says of a campaign with a limit: photographs saved or quality gained, and whether the limit is kept."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from scipy import stats

from tuner.evaluation.baselines import TUNED, controls_at_equal_number
from tuner.evaluation.baselines import label as strategy_label
from tuner.evaluation.comparison import (
    ComparisonRow,
    ComparisonTable,
    strategy_difference,
    strategy_interval,
    values_of,
)
from tuner.evaluation.paper_table import MetricRow
from tuner.evaluation.plan import EvaluationRecord
from tuner.evaluation.statistics import Interval, PairedDifference
from tuner.problem.objective import Objective
from tuner.problem.quality_at_cost import COUNTS
from tuner.report.comparison.tables import gain_interval
from tuner.report.labels import format_number, metric_label, with_unit

DEFAULT_MARGIN = 1.0  # percent points of F-score


@dataclass(frozen=True)
class LimitAsked:
    """An objective with a limit on a second one, and how much quality may be lost and still count as kept."""

    objective: Objective
    second: Objective
    limit: float  # of the second, its unit
    margin: float = DEFAULT_MARGIN  # of the quality, its unit

    @property
    def text(self) -> str:
        """``F-score at least 98.0 %``."""
        label = metric_label(self.second.metric)
        bound = "at least" if self.second.direction == "maximise" else "at most"
        return f"{label.name} {bound} {with_unit(self.limit, label.unit, 0 if self.second.metric in COUNTS else 1)}"


def row_of(objective: Objective) -> MetricRow:
    """A table row in the direction of an objective."""
    label = metric_label(objective.metric)
    return MetricRow("", label.name, objective.metric, label.unit, objective.direction == "maximise", 1)


def share_kept(records: Sequence[EvaluationRecord], strategy: str, asked: LimitAsked) -> Interval | None:
    """Share of the rocks, in percent, whose mean keeps the limit; Wilson's 95 % interval.

    A rock on which a mission failed has not kept it. None where the strategy has no mission.
    """
    own = [r for r in records if r.strategy == strategy]
    rocks = sorted({r.rock for r in own})
    if not rocks:
        return None
    found = values_of(records, strategy, asked.second.metric)
    kept = 0
    for rock in rocks:
        values = [value for (where, _), value in found.items() if where == rock]
        if values and len(values) == sum(r.rock == rock for r in own):
            mean = sum(values) / len(values)
            kept += asked.second.sign * mean >= asked.second.sign * asked.limit - 1e-9
    bounds = stats.binomtest(kept, len(rocks)).proportion_ci(method="wilson")
    return Interval(
        100 * kept / len(rocks), 100 * bounds.low, 100 * bounds.high, len(rocks), len(own), "wilson"
    )


def limit_rows(
    table: ComparisonTable, records: Sequence[EvaluationRecord], asked: LimitAsked | None
) -> ComparisonTable:
    """``table`` with what the campaign limited first: photographs, and the share of rocks that kept the limit."""
    if asked is None:
        return table
    rows = []
    for objective in (asked.objective, asked.second):
        if objective.metric in COUNTS:
            metric = replace(row_of(objective), group="Campaign")
            cells = {name: strategy_interval(records, name, metric.key) for name in table.strategies}
            rows.append(ComparisonRow(metric, cells, _best(cells, min), None, {}))
    shares = {name: share_kept(records, name, asked) for name in table.strategies}
    kept = MetricRow("Campaign", "Limit kept", "limit", "% of rocks", True, 0)
    rows.append(ComparisonRow(kept, shares, _best(shares, max), None, {}))
    return replace(table, rows=[*rows, *table.rows])


def _best(cells: dict[str, Interval | None], pick: Callable[[list[float]], float]) -> tuple[str, ...]:
    means = {name: cell.mean for name, cell in cells.items() if cell is not None}
    return tuple(name for name, mean in means.items() if mean == pick(list(means.values())))


def limit_sentences(records: Sequence[EvaluationRecord], reference: str, asked: LimitAsked) -> list[str]:
    """One sentence per verdict on the tuned strategy against ``reference``; empty without common missions."""
    out = []
    for objective in (asked.objective, asked.second):
        d = strategy_difference(records, TUNED, reference, row_of(objective))
        if d is None:
            return []
        if objective.metric in COUNTS:
            ours = strategy_interval(records, TUNED, objective.metric)
            theirs = strategy_interval(records, reference, objective.metric)
            assert ours is not None and theirs is not None
            out.append(_count(objective, ours.mean, theirs.mean, strategy_label(reference)))
        else:
            out.append(_quality(objective, d, strategy_label(reference), asked.margin))
    if best := _best_control(records, asked):
        out.append(best)
    share = share_kept(records, TUNED, asked)
    if share is not None and share.low is not None and share.high is not None:
        kept = round(share.mean * share.rocks / 100)
        out.append(
            f"Limit ({asked.text}): kept on {kept} of {share.rocks} rocks "
            f"({share.mean:.0f} %, 95 % interval {share.low:.0f} to {share.high:.0f} %)."
        )
    return out


def _best_control(records: Sequence[EvaluationRecord], asked: LimitAsked) -> str:
    """The gain over the best control at equal number in the quality; empty where none was flown."""
    quality = next((o for o in (asked.objective, asked.second) if o.metric not in COUNTS), None)
    names = controls_at_equal_number(sorted({r.strategy for r in records}))
    if quality is None:
        return ""
    means = {name: strategy_interval(records, name, quality.metric) for name in names}
    known = {name: quality.sign * cell.mean for name, cell in means.items() if cell is not None}
    if not known:
        return ""
    best = max(known, key=lambda name: known[name])
    d = strategy_difference(records, TUNED, best, row_of(quality))
    if d is None:
        return ""
    said = _quality(quality, d, strategy_label(best), asked.margin)
    return f"Over the best control at equal number ({strategy_label(best)}): {said[0].lower()}{said[1:]}"


def _count(objective: Objective, ours: float, theirs: float, reference: str) -> str:
    name, saved = metric_label(objective.metric).name, theirs - ours
    what = "saved" if saved > 0 else "more" if saved < 0 else "no difference"
    amount = f"{_number(abs(saved))} {what}" if saved else what
    return f"{name}: {_number(ours)} in place of {_number(theirs)} of {reference}, {amount}."


def _number(value: float) -> str:
    return f"{value:.0f}" if float(value).is_integer() else f"{value:.1f}"


def _quality(objective: Objective, d: PairedDifference, reference: str, margin: float) -> str:
    label = metric_label(objective.metric)
    gain, low, high = gain_interval(d, row_of(objective))
    how = f"{label.full} {with_unit(gain, label.difference_unit, 1, signed=True)} against {reference}"
    if low is None or high is None:
        return f"Quality: {how}; too few missions for an interval, so nothing is said about the margin."
    how += f", 95 % interval {format_number(low, 1, signed=True)} to {format_number(high, 1, signed=True)}"
    allowed = with_unit(margin, label.difference_unit, 1)
    if low > 0:
        return f"Quality gained: {how}."
    if low >= -margin:
        return f"Quality kept within {allowed}: {how}."
    if high < -margin:
        return f"Quality lost by more than {allowed}: {how}."
    return f"Not shown that quality is kept within {allowed}: {how}."
