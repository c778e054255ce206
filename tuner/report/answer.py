"""The recommendation of a campaign as sentences, the same on its page and on the terminal."""

from __future__ import annotations

import collections
import contextlib
import itertools
import re
import shlex
import statistics
from typing import TYPE_CHECKING

from nbv.config import MissionConfig
from nbv.errors import UserError
from nbv.mission.result import IterationRecord, MissionResult
from tuner.comparison.advice import Next, leaves_room
from tuner.comparison.verdict import Kind
from tuner.missions.registry import mission_kind
from tuner.problem.baselines import ARMS, TUNED, is_orbit
from tuner.problem.baselines import label as strategy_label
from tuner.problem.observations import short
from tuner.problem.search_space import Configuration, builtin
from tuner.report.labels import (
    MISSING,
    MetricLabel,
    bracketed,
    ceiling_text,
    counted,
    decimals_for,
    difference_text,
    format_number,
    gain_words,
    metric_label,
    number_text,
    parameter_label,
    short_names,
)
from tuner.report.table import Cell, Row, Table

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from typing import Any

    from tuner.campaign.campaign import Campaign
    from tuner.campaign.settings import CampaignSettings
    from tuner.comparison.advice import Advice
    from tuner.comparison.result import Results
    from tuner.missions.job import Trial
    from tuner.problem.instances import Instance
    from tuner.problem.intervals import Interval
    from tuner.recommendation.recommendation import Limit, Recommendation

POOR_COVERAGE = 0.85  # of 95 % intervals, below which it is said that they are too narrow
MIN_MISSIONS_FOR_COVERAGE = 12
FEW = 3  # changes that a sentence can name
PLAN = ("seed.", "stop.")  # parameters that `plan_words` puts into words
OPTIMISM_NOTE = "The recommendation was selected on these trials, so its intervals are optimistic."
GEOMETRIC = "These values are predictions of geometric missions, in which no photograph is taken."


# -- what to use ---------------------------------------------------------------------------------------------


def use_sentence(best: Recommendation, s: CampaignSettings) -> str:
    """``Fly 14 photographs on rings, then 12 chosen by the planner; and Pool: highest elevation 20 °.``"""
    word = s.problem.instance_word
    verb = "Fly" if word == "rock" else "Use"
    if best.limit is not None and not best.limit.kept:
        nearest = "the default" if best.keep_default else configuration_words(best.values, best, s)
        return f"No configuration that was evaluated is likely to meet the constraint ({limit_words(best.limit)}); nearest to it comes {nearest}, which misses it by {best.limit.missed_by:.3g}."
    plan = plan_words(s.problem.config(best.values))
    if best.plain and not best.keep_default:
        what = "the orbit" if is_orbit(best.plain) else strategy_label(best.plain).lower()
        return f"Fly {what}: {plan}; no planner was better on the training {word}s."
    if best.keep_default:
        default = f"the default{f' ({plan})' if plan else ''}"
        return f"Keep {default}: no configuration that was evaluated is known to be better."
    return f"{verb} {configuration_words(best.values, best, s)}."


def advice_lines(advice: Advice, best: Recommendation, s: CampaignSettings) -> list[str]:
    """What to fly, what it gains over the best plain plan and over the reference, on how many instances, and what an orbit would lose."""
    word, said = s.problem.instance_word, [use_sentence(best, s)]
    where = there(advice.results, word, advice.gain)
    if advice.fly != TUNED and advice.over_plain is not None:
        label, gain = metric_label(advice.over_plain.metric), advice.over_plain.gain
        lost = (
            "" if gain is None else f" by {difference_text(gain.reversed)} {label.difference_unit}".rstrip()
        )
        said[0] = (
            f"Fly {strategy_label(advice.plain)} ({plan_words(advice.config)}): on {where} it beats what the campaign "
            f"recommends ({configuration_words(best.values, best, s)}){lost}."
        )
    against = {
        v.reference: v for v in (advice.over_reference, advice.over_plain) if v and v.strategy == advice.fly
    }
    gains = list[tuple[str, str]]()
    for verdict in reversed(against.values()):
        unit = metric_label(verdict.metric).difference_unit
        over = strategy_label(verdict.reference)
        over = f"the best plain plan ({over})" if verdict is advice.over_plain else over
        if (gain := verdict.gain) is not None:
            text = f"{f'{difference_text(gain)} {unit}'.strip()} against {over}"
            gains.append((text, there(advice.results, word, gain)))
    if gains:
        texts, places = zip(*gains)
        each = ", ".join(f"{text} on {place}" for text, place in gains)
        has = f"It has {each}" if len({*places}) > 1 else f"On {places[0]} it has {', '.join(texts)}"
        said.append(f"{has} (95 % intervals; above 0 is better).")
    if advice.fly != TUNED:
        said.append(f"It was chosen on these {word}s, so its intervals are optimistic.")
    if best.plain == ARMS[0] and advice.over_plain is not None and not advice.results.held_out:
        said.append(f"That does not tell which is better on other {word}s: docs/results/what_to_fly.md.")
    if advice.is_plain and not best.keep_default and advice.over_plain is None:
        said.append(f"It is the best of the plain plans there ({strategy_label(advice.plain)}).")
    orbit_is_plain = advice.over_plain and advice.by_orbit and advice.by_orbit.strategy == advice.plain
    if advice.by_orbit is not None and advice.by_orbit.gain is not None and not orbit_is_plain:
        unit = metric_label(advice.by_orbit.metric).difference_unit
        orbit, gain = strategy_label(advice.by_orbit.strategy), advice.by_orbit.gain
        said.append(f"{orbit} in its place would be {gain_words(gain.mean, unit)} ({difference_text(gain)}).")
    if advice.ceiling is not None:
        room = leaves_room(advice.ceiling)
        said.append(ceiling_text(advice.ceiling, strategy_label(advice.plain), room=room))
    return said


def there(results: Results, word: str, gain: Interval | None = None) -> str:
    """``2 held-out rocks``: those of ``gain``, without one those on which the recommendation has run."""
    number = len(results.rocks) if gain is None else gain.rocks
    return counted(number, f"held-out {word}" if results.held_out else f"training {word}")


def next_text(step: Next, campaign: Campaign, advice: Advice | None) -> tuple[str, str]:
    """What to do now and its command; an empty command means to stop."""
    s, status = campaign.settings, campaign.status()
    word, count = s.problem.instance_word, advice.instances if advice else 0
    where = there(advice.results, word, advice.gain) if advice else ""
    plain = strategy_label(advice.plain) if advice else ""
    evidence = "no plain plan is better"
    if advice is not None and advice.is_plain:
        evidence = "nothing that was run is shown to be better"
    elif advice is not None and advice.over_plain is not None and advice.over_plain.kind is Kind.BETTER:
        evidence = f"it is better than every plain plan, {plain} the best of them,"
    run = shlex.join([str(campaign.directory), *s.problem.options()])
    resume, evaluate = f"gatetune campaign resume {run}", f"gatetune evaluate {run}"
    if s.problem.draws_rocks:
        evaluate += "".join(f" --rock {rock}" for rock in s.rocks)
    export = f"gatetune export {shlex.quote(str(campaign.directory))}"
    finish = f"Finish it: {status.remaining} of {status.budget} missions are left."
    more = "Run more missions", f"{resume} --missions {2 * status.budget}"
    if status.exhausted:
        more = "Begin a campaign in a wider search space, since this one has nothing left to try", ""
    if status.failures and not status.complete:
        reason = max(status.failures, key=lambda r: status.failures[r])
        finish = f"Every mission failed, most often with {reason!r}: correct that (see below), then resume."
    return {
        Next.RUN: (finish, resume),
        Next.MORE: (
            f"{more[0]}, or relax the constraint if there is one: nothing that was run is known to be good enough.",
            more[1],
        ),
        Next.CONFIRM: (
            "Confirm it in new replicates: your mission file has no held-out instance.",
            f"gatetune confirm {run}",
        ),
        Next.EVALUATE: (
            f"Evaluate it on held-out {word}s: all that counts so far ran where it was tuned.",
            evaluate,
        ),
        Next.MORE_INSTANCES: (
            f"Evaluate it on more {word}s: {counted(count, word)} cannot represent others.",
            evaluate,
        ),
        Next.FLY_PLAIN: (f"Stop, and fly {plain}: on {where} it is better than what was tuned.", export),
        Next.FLY: (f"Stop, and fly it: {evidence} on {where}.", export),
        Next.TRY_PLANNERS: (
            f"Fly it, or try other planners with gatetune compare: {evidence} on {where}, and the oracle shows room.",
            export,
        ),
        Next.KEEP: ("Stop: keep the default. Nothing that has run often enough is known to be better.", ""),
    }[step]


def configuration_words(values: Mapping[str, Any], best: Recommendation, s: CampaignSettings) -> str:
    """Which parameters of a configuration differ from the default."""
    changed = [path for path, value in values.items() if value != best.default_values[path]]
    planned = [path for path in changed if path.startswith(PLAN)]
    plan = plan_words(s.problem.config(values)) if planned else ""
    rest = [path for path in changed if not plan or path not in planned]
    if plan and builtin(s.problem.config(values)).adaptive_budget == 0:
        rest = []
    if len(rest) > FEW:
        named = f"{len(rest)} changes"
    else:
        named = ", ".join(f"{parameter_label(path).name} {value_text(values, path)}" for path in rest)
    if plan:
        return f"{plan}; and {named}" if rest else plan
    return f"the default with {named}" if rest else "the default"


def plan_words(config: Configuration) -> str:
    """How many photographs are taken where; empty for a mission file's configuration."""
    if not isinstance(config, MissionConfig):
        return ""
    seed, rings = config.seed, f"{config.seed.total} photographs on rings"
    if seed.count and seed.layout == "turn":
        rings = f"{seed.count - seed.upper_count} photographs at {seed.lowest_deg:.0f}°"
        rings += f" and {seed.upper_count} at {seed.upper_deg:.0f}°" if seed.upper_count else ""
    if not config.adaptive_budget:
        return rings
    if config.stop.may_end_early:
        most = seed.total + config.adaptive_budget
        return f"{rings}, then planned ones until the stop criterion holds, at most {most} in all"
    by = _PLANNERS.get(config.gate.kind, f"by {strategy_label(config.gate.kind)}")
    return f"{rings}, then {config.adaptive_budget} chosen {by}"


_PLANNERS = {"hyb-h": "by the planner", "random": "at random"}


def value_text(values: Mapping[str, Any], path: str) -> str:
    return f"{short(values[path])} {parameter_label(path).unit}".strip()


# -- what it is worth ----------------------------------------------------------------------------------------


def worth_sentences(best: Recommendation, s: CampaignSettings) -> list[str]:
    """The recommendation's outcome on the training rocks, and how far the model can be trusted."""
    word, label = s.problem.instance_word, metric_label(best.metric)
    said = f"By the model, {_subject(label).replace('The ', 'the ')} is "
    if best.keep_default:
        said += f"{mean_text(label, best.mean, best.sd, best.interval_95)} on the training {word}s"
    else:
        said += f"{mean_text(label, best.mean, best.sd)} in place of {mean_text(label, best.default_mean, best.sd)}"
        said += f" on the training {word}s, {_gain(best.improvement, best.improvement_interval_95, best.improvement_sd, label)}"
        said += ", positive if lower" if best.direction == "minimise" else ""
    lines = [f"{said} (brackets: 95 % interval)."]
    if best.limit is not None:
        lines.append(_limit_sentence(best, best.limit))
    if len(s.rocks) == 1 and not s.problem.draws_rocks:
        lines.append(f"Only one {word} was run, so how {word}s differ is not known.")
    lines += outlier_sentences(best, s.goal.shown.metric)
    if best.observations < MIN_MISSIONS_FOR_COVERAGE:
        missions = counted(best.observations, "successful mission")
        lines.append(
            f"The model has only {missions}, so its priors dominate and its intervals cannot be checked yet."
        )
    elif (coverage := best.leave_one_out["coverage_95"]) < POOR_COVERAGE:
        lines.append(
            f"The model's 95 % intervals contained only {100 * coverage:.0f} % of the left-out missions: all intervals are too narrow."
        )
    if mission_kind(s.fidelity).predicts:
        lines.append(GEOMETRIC)
    if best.keep_default:
        evaluated = len({row.rock for row in best.per_rock if row.missions})
        return [*lines, f"It was evaluated on {evaluated} of {counted(len(s.rocks), word)}."]
    return [*lines, OPTIMISM_NOTE]


def outlier_sentences(best: Recommendation, metric: str) -> list[str]:
    """Which missions are outliers, and whether they are left out or count with another outcome."""
    name, said = short_name(metric_label(metric)), []
    for o in best.outliers[:FEW]:
        line = f"Mission #{o.mission:04d} measured {name} {number_text(o.measured)}, "
        if o.counts_as is None:
            line += "which all others contradict. The recommendation does not use it; run its configuration again if it may be right."
        else:
            line += f"far from all others; the model uses {number_text(o.counts_as)} in its place."
        said.append(line)
    if len(best.outliers) > FEW:
        said.append(f"{len(best.outliers) - FEW} more missions are outliers, too.")
    return said


def _limit_sentence(best: Recommendation, limit: Limit) -> str:
    """Of the limited metric: its mean, and the probability that the constraint is met."""
    label, (_, bound_text) = metric_label(limit.metric), bound(limit.metric, limit.direction, limit.limit)
    mean = mean_text(label, limit.mean, limit.sd, limit.interval_95)
    default = (
        f"{mean_text(label, limit.default_mean, limit.sd)}, with probability {limit.default_probability:.2f}"
    )
    said = f"{_subject(label)} is {mean}; the constraint is {bound_text}, met with probability {limit.probability:.2f}"
    return f"{said}." if best.keep_default else f"{said}; the default has {default}."


# -- what the gate did ---------------------------------------------------------------------------------------


def gate_words(records: Sequence[IterationRecord], gate: str, missions: int) -> str:
    """How often each scorer chose, how often both had the same best view, and how often the gate switched."""
    n = len(records)
    counts = collections.Counter(record.scorer for record in records)
    views = [[best.get("candidate") for best in record.top.values()] for record in records]
    equal = sum(len(ids) > 1 and len(set(ids)) == 1 for ids in views)
    where = f"{n} views of {counted(missions, 'mission')}"
    same = f" In {_percent(equal, n)} both scorers had the same best view." if equal else ""
    if len(counts) == 1:
        (scorer,) = counts
        return f"The gate ({gate}) never switched: {strategy_label(scorer)} chose all {where}.{same}"
    shares = ", ".join(f"{strategy_label(s)} {_percent(c, n)}" for s, c in counts.most_common())
    following = [(a, b) for a, b in itertools.pairwise(records) if b.iteration == a.iteration + 1]
    switches = sum(a.scorer != b.scorer for a, b in following)
    return f"{gate} switched in {_percent(switches, len(following))} of its steps: {shares} of {where}.{same}"


def traces_of(trials: Sequence[Trial]) -> list[list[IterationRecord]]:
    """Return the traces of those trials that planned a view."""
    traces = []
    for t in trials:
        with contextlib.suppress(UserError, OSError):
            traces.append(MissionResult.load(t.record.directory).trace)
    return [trace for trace in traces if trace]


def gate_sentences(best: Recommendation, campaign: Campaign) -> list[str]:
    """In how many trials the gate switched, which tuned parameters had no effect, what would make it switch, what it chose."""
    s, trials = campaign.settings, [t for t in campaign.trials() if t.state == "complete"]
    config = s.problem.config(best.values)
    if not isinstance(config, MissionConfig):
        return []
    if config.adaptive_budget == 0:
        return ["The recommended plan has no planned view, so no gate is used."]
    planned = [t for t in trials if t.record.switched is not None]
    if not planned:
        return []
    switched = sum(bool(t.record.switched) for t in planned)
    said = [f"The gate switched between scorers in {switched} of {len(planned)} missions."]
    reset = [
        t.record.metadata["without_effect"] for t in trials if t.record.metadata.get("phase") == "simplified"
    ]
    if reset:
        named = ", ".join(parameter_label(path).name for path in reset[-1])
        said.append(f"Without effect on any photograph, so left at the default: {named}.")
    never = traces_of([t for t in planned if t.values == best.default_values and not t.record.switched])
    spread = [r.d95_m for trace in never for r in trace if r.d95_m is not None]
    gate = builtin(s.problem.config(best.default_values)).gate
    if spread and not min(spread) < gate.d95_m < max(spread):
        said.append(
            f"At the default it does not switch where d95 is {min(spread):.2f} to {max(spread):.2f} m, since the threshold is "
            f"{gate.d95_m:.2f} m; a gate.d95_m within that range would make it switch."
        )
    traces = traces_of([t for t in planned if t.values == best.values])
    if traces:
        said.append(gate_words(list(itertools.chain(*traces)), strategy_label(config.gate.kind), len(traces)))
    return said


# -- tables ----------------------------------------------------------------------------------------------------


def changed_table(best: Recommendation) -> Table:
    """The parameters that differ from the default."""
    both = best.values, best.default_values
    rows = [
        Row(path, tuple(Cell(value_text(values, path)) for values in both), parameter_label(path).name)
        for path in best.changed
    ]
    return Table("", ("parameter", "use", "default"), rows)


def rock_table(best: Recommendation, campaign: Campaign) -> Table:
    """Instance by instance what the recommendation and the default had there, with the number of their missions."""
    s, trials, shown = campaign.settings, campaign.trials(), campaign.settings.goal.shown
    label, digits = metric_label(shown.metric), decimals_for(best.noise_sd)
    rocks = dict(zip(s.rocks, short_names(s.rocks)))

    def measured(values: Mapping[str, Any], instance: Instance) -> str:
        here = [t for t in trials if t.instance == instance and t.values == values]
        measurements = [t.raw if shown == s.objective else t.measured(shown) for t in here]
        known = [value for value in measurements if value is not None]
        return f"{format_number(statistics.fmean(known), digits)} ({len(known)})" if known else MISSING

    rows = [
        (
            row.instance._replace(rock=rocks.get(row.rock, row.rock)).label,
            format_number(label.possible(row.predicted), digits),
            *(measured(values, row.instance) for values in (best.values, best.default_values)),
        )
        for row in best.per_rock
    ]
    caption = (
        f"{label.axis} of the recommended configuration: its posterior mean there, and the mean of the missions that ran "
        "there, with their number."
    )
    columns = (s.problem.instance_word, "predicted", "measured", "default measured")
    return Table.of("", columns, rows, caption)


# -- small things --------------------------------------------------------------------------------------------


def limit_words(limit: Limit) -> str:
    """``F-score at least 98 %``."""
    return " ".join(bound(limit.metric, limit.direction, limit.limit))


def bound(metric: str, direction: str, limit: float) -> tuple[str, str]:
    """What is bounded, and how: ``F-score`` and ``at least 98 %``."""
    label = metric_label(metric)
    how = f"{'at least' if direction == 'maximise' else 'at most'} {limit:g} {label.unit}".strip()
    return short_name(label), how


def short_name(label: MetricLabel) -> str:
    """``F-score`` of ``F-score @ 48 mm``."""
    return re.sub(r" @ [\d.]+ mm", "", label.name)


def _subject(label: MetricLabel) -> str:
    """``F-score``; ``The number of photographs`` of what is counted."""
    name = short_name(label)
    return f"The number of {name.lower()}" if name.endswith("hotographs") else name


def mean_text(
    label: MetricLabel, mean: float, sd: float, interval_95: tuple[float, float] | None = None
) -> str:
    """``98.3 %``, or ``98.3 [97.8, 98.8] %``; what a configuration decides (``sd`` 0) as it is."""
    if sd <= 0:
        return f"{mean:.4g} {label.unit}".strip()
    if interval_95 is None:
        return label.value(mean, decimals_for(sd, 1))
    middle, low, high = map(label.possible, (mean, *interval_95))
    return f"{bracketed(middle, low, high, decimals_for(sd, 1))} {label.unit}".strip()


def _gain(mean: float, interval_95: tuple[float, float], sd: float, label: MetricLabel) -> str:
    """``+0.6 [+0.2, +1.0] points``."""
    return (
        f"{bracketed(mean, *interval_95, decimals_for(sd, 1), signed=True)} {label.difference_unit}".strip()
    )


def _percent(part: int, whole: int) -> str:
    return f"{100 * part / whole:.0f} %" if whole else "0 %"
