"""Table cells of studies: means, and paired differences that say when nothing differs at all."""

from __future__ import annotations

from collections.abc import Sequence

from tuner.comparison.statistics import Interval, MetricRow
from tuner.report.labels import MISSING, format_number, interval_methods

EXACTLY_ZERO = "0 exactly"


def difference_text(i: Interval | None, decimals: int, *, bold: bool = True) -> str:
    """``+1.2 [−0.3, +2.7]``, bold where the interval excludes zero; ``0 exactly`` if no pair differs."""
    if i is None:
        return MISSING
    if i.mean == 0 and (i.low or 0) == (i.high or 0) == 0:  # no pair differs at all
        return EXACTLY_ZERO
    text = format_number(i.mean, decimals, signed=True)
    if i.low is None or i.high is None:
        return text
    bounds = (format_number(bound, decimals, signed=True) for bound in (i.low, i.high))
    text = f"{text} [{', '.join(bounds)}]"
    return f"**{text}**" if bold and (i.low > 0 or i.high < 0) else text


def mean_text(interval: Interval | None, decimals: int) -> str:
    """The mean alone: a mean over rocks has an interval that is mostly the rocks' own differences."""
    return MISSING if interval is None else format_number(interval.mean, decimals)


def heading(row: MetricRow, *, difference: bool = False) -> str:
    """``F-score @ 48 mm ↑ (%)``; differences of percentages are points."""
    unit = "points" if difference and row.unit == "%" else row.unit
    return f"{row.label} {'↑' if row.higher_is_better else '↓'} ({unit})"


def interval_sentence(intervals: Sequence[Interval | None]) -> str:
    """How the intervals were made."""
    return interval_methods({i.method for i in intervals if i is not None})


def markdown_table(header: Sequence[str], rows: Sequence[Sequence[str]], left: int = 1) -> list[str]:
    """GitHub-flavoured markdown; the first ``left`` columns are flush left, the others right."""
    rule = "|" + "---|" * left + "---:|" * (len(header) - left)
    return ["| " + " | ".join(header) + " |", rule, *("| " + " | ".join(row) + " |" for row in rows)]
