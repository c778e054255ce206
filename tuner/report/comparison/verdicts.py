"""What a comparison says in words: a sentence per objective, the limit, and the best control."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from scipy import stats

from tuner.evaluation.baselines import TUNED, controls_at_equal_number
from tuner.evaluation.baselines import label as strategy_label
from tuner.evaluation.comparison import strategy_difference, strategy_interval, values_of
from tuner.evaluation.flying import EvaluationRun
from tuner.evaluation.of_campaign import Asked
from tuner.evaluation.paper_table import MetricRow
from tuner.evaluation.statistics import Interval, PairedDifference
from tuner.missions.job import Trial
from tuner.problem.objective import Objective
from tuner.report.comparison.tables import difference_verdict, gain_interval
from tuner.report.labels import format_number, metric_label, with_unit


class Sentence(NamedTuple):
    """One line for a reader, and whether it is good news."""

    text: str
    kind: str = ""  # better, worse, no


def row_of(objective: Objective, decimals: int = 1) -> MetricRow:
    """A table row in the direction of an objective."""
    label = metric_label(objective.metric)
    return MetricRow(
        "", label.name, objective.metric, label.unit, objective.direction == "maximise", decimals
    )


def verdicts(run: EvaluationRun, reference: str, asked: Asked) -> list[Sentence]:
    """The verdict on the tuned strategy, without one on the first that is not ``reference``, line by line."""
    others = [name for name in run.plan.strategies if name != reference]
    if not others:
        return []
    subject = TUNED if TUNED in others else others[0]
    out = []
    if run.plan.owner(subject) != run.plan.owner(reference):
        objectives = [*asked.counts, asked.quality] if asked.quality else asked.counts
        out = [_against(run.records, subject, reference, o, asked) for o in objectives]
    if subject == TUNED and asked.limit is not None:
        out += _limit(run.records, asked)
    if subject == TUNED and asked.quality is not None:
        out += _best_control(run, reference, asked.quality, asked.place)
    return out


def share_kept(records: Sequence[Trial], strategy: str, asked: Asked) -> Interval | None:
    """Share of the rocks, in percent, whose mean keeps the limit; Wilson's 95 % interval.

    A rock on which a mission failed has not kept it. None where the strategy has no mission.
    """
    assert asked.second is not None and asked.limit is not None
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
    share = 100 * kept / len(rocks)
    if asked.second.metric in asked.decided:
        return Interval(share, None, None, len(rocks), len(own), "none")
    bounds = stats.binomtest(kept, len(rocks)).proportion_ci(method="wilson")
    return Interval(share, 100 * bounds.low, 100 * bounds.high, len(rocks), len(own), "wilson")


def _limit(records: Sequence[Trial], asked: Asked) -> list[Sentence]:
    share = share_kept(records, TUNED, asked)
    if share is None or asked.second is None:
        return []
    label, kept = metric_label(asked.second.metric), round(share.mean * share.rocks / 100)
    bound = "at least" if asked.second.direction == "maximise" else "at most"
    unit = f" {label.unit}" if label.unit else ""
    text = f"Limit ({label.full}: {bound} {asked.limit:g}{unit}): kept on {kept} of {counted(share.rocks, asked.place)}"
    if share.low is not None and share.high is not None:
        text += f" ({share.mean:.0f} %, 95 % interval {share.low:.0f} to {share.high:.0f} %)"
    return [Sentence(f"{text}.", "better" if kept == share.rocks else "worse" if kept == 0 else "no")]


def _best_control(run: EvaluationRun, reference: str, quality: Objective, place: str) -> list[Sentence]:
    """Against the best control at equal number that is not the reference itself; nothing where none was flown."""
    names = [name for name in controls_at_equal_number(run.plan.strategies) if name != reference]
    means = {name: strategy_interval(run.records, name, quality.metric) for name in names}
    known = {name: quality.sign * cell.mean for name, cell in means.items() if cell is not None}
    if not known:
        return []
    best = max(known, key=lambda name: known[name])
    whom = f"the best control at equal number ({strategy_label(best)})"
    d = strategy_difference(run.records, TUNED, best, row_of(quality))
    return [] if d is None else [_plain(strategy_label(TUNED), whom, quality, d, place)]


def _against(
    records: Sequence[Trial], name: str, reference: str, objective: Objective, asked: Asked
) -> Sentence:
    who, whom = strategy_label(name), strategy_label(reference)
    d = strategy_difference(records, name, reference, row_of(objective))
    if d is None:
        return Sentence(f"{who}: no mission in common with {whom}.")
    if objective.metric in asked.decided:
        ours, theirs = (strategy_interval(records, n, objective.metric) for n in (name, reference))
        assert ours is not None and theirs is not None
        return _count(objective, ours.mean, theirs.mean, whom)
    if asked.limit is None:
        return _plain(who, whom, objective, d, asked.place)
    return _kept(whom, objective, d, asked)


def _count(objective: Objective, ours: float, theirs: float, whom: str) -> Sentence:
    """``Photographs: 26 in place of 32 of Hyb-H, 6 saved.``; counts have no interval."""
    label, fewer = metric_label(objective.metric), ours < theirs
    change = "as many"
    if ours != theirs:
        saved = "saved" if objective.direction == "minimise" else "fewer"
        change = f"{_number(abs(ours - theirs))} {saved if fewer else 'more'}"
    better = fewer == (objective.direction == "minimise")
    text = f"{label.name}: {_number(ours)} in place of {_number(theirs)} of {whom}, {change}."
    return Sentence(text, "no" if ours == theirs else "better" if better else "worse")


def _number(value: float) -> str:
    return f"{value:.0f}" if float(value).is_integer() else f"{value:.1f}"


def _plain(who: str, whom: str, objective: Objective, d: PairedDifference, place: str) -> Sentence:
    kind = difference_verdict(d, row_of(objective))
    begin = {
        "better": f"{who} is better than {whom}",
        "worse": f"{who} is worse than {whom}",
        "no difference detected": f"No difference detected between {who} and {whom}",
        "no interval": f"{who} against {whom}",
    }[kind]
    text = f"{begin} in {metric_label(objective.metric).full}: improvement {_gain(objective, d, place)}."
    return Sentence(text, kind.split()[0])


def _kept(whom: str, objective: Objective, d: PairedDifference, asked: Asked) -> Sentence:
    """Whether the quality is no worse than ``whom``'s by more than the margin."""
    label, margin = metric_label(objective.metric), asked.margin
    _, low, high = gain_interval(d, row_of(objective))
    allowed = with_unit(margin, label.difference_unit)
    if low is None or high is None:
        begin, kind = "Quality", "no"
    elif low > 0:
        begin, kind = "Quality gained", "better"
    elif high < -margin:
        begin, kind = f"Quality lost by more than {allowed}", "worse"
    elif low >= -margin:
        begin, kind = f"Quality kept within {allowed}", "no" if high < 0 else "better"
    else:
        begin, kind = f"Quality not shown to be kept within {allowed}", "worse" if high < 0 else "no"
    return Sentence(f"{begin}: {label.full} against {whom}: {_gain(objective, d, asked.place)}.", kind)


def _gain(objective: Objective, d: PairedDifference, place: str) -> str:
    """``+1.8 points (95 % interval +1.2 to +2.3; 12 paired missions on 4 rocks)``."""
    label = metric_label(objective.metric)
    gain, low, high = gain_interval(d, row_of(objective))
    bounds = "too few missions for an interval"
    if low is not None and high is not None:
        bounds = f"95 % interval {format_number(low, signed=True)} to {format_number(high, signed=True)}"
    where = f"{counted(d.pairs, 'paired mission')} on {counted(d.interval.rocks, place)}"
    if d.interval.method == "replicates":  # such an interval has no spread between rocks
        where += f", for {'this' if d.interval.rocks == 1 else 'these'} alone"
    return f"{with_unit(gain, label.difference_unit, signed=True)} ({bounds}; {where})"


def counted(count: int, what: str) -> str:
    """``1 rock``, ``3 rocks``."""
    return f"{count} {what}" if count == 1 else f"{count} {what}s"
