"""The first screen of a campaign's page: five questions, each with an answer that the state of the campaign decides."""

from __future__ import annotations

import collections
import contextlib
import itertools
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from nbv.config import MissionConfig
from nbv.errors import UserError
from nbv.mission.result import IterationRecord, MissionResult
from tuner.campaign.ledger import TrialRecord
from tuner.missions.registry import is_geometric
from tuner.problem.configurations import configuration_key
from tuner.recommendation.recommendation import Limit, Recommendation
from tuner.report.campaign.facts import CampaignFacts
from tuner.report.labels import (
    decimals_for,
    format_number,
    metric_label,
    parameter_label,
    parameter_value,
    strategy_label,
    verdict,
    with_unit,
)

FEW = 3  # changes that a sentence can name
EDGE = 0.005  # of the searched range: nearer to a bound counts as at it
_NOTHING = 0.01  # of the noise of a mission
EQUAL = "="  # both scorers' best view was the same: the gate had no choice


@dataclass(frozen=True)
class Pair:
    """One rock, condition and replicate: what the default and the recommended configuration had there."""

    place: str
    default: float | None
    recommended: float | None


@dataclass(frozen=True)
class GateRow:
    """One mission: at each adaptive capture the scorer that chose, or `EQUAL`."""

    name: str
    choices: tuple[str, ...]


# -- What should I use? --------------------------------------------------------------------------------------


def use_values(facts: CampaignFacts) -> dict[str, Any]:
    """The configuration to use."""
    assert facts.recommendation is not None
    return dict(facts.recommendation.values)


def flown(facts: CampaignFacts, values: Mapping[str, Any]) -> list[TrialRecord]:
    """The successful missions of exactly these values."""
    key = configuration_key(facts.settings.space, values)
    own = [t for t in facts.trials if t.state == "complete"]
    return [t for t in own if configuration_key(facts.settings.space, t.values) == key]


def use_answer(facts: CampaignFacts) -> dict[str, Any]:
    """One sentence, the parameters that differ from the default, and the rest."""
    best = facts.recommendation
    if best is None:
        return {
            "sentence": f"Nothing yet: none of the {facts.status.finished} finished missions succeeded.",
            "kept": [],
            "rest": "",
            "notes": [],
            "silent": [],
        }
    values, space = use_values(facts), facts.settings.space
    kept = [p.path for p in space.parameters if values[p.path] != facts.default[p.path]]
    if not kept:
        sentence = f"Use the {facts.default_name}: nothing tuned is known to be worth more."
    else:
        text = ", ".join(f"{parameter_label(p).name} = {_value(values, p)}" for p in kept)
        if len(kept) > FEW:
            text = f"these {len(kept)} changes"
        sentence = f"Use the {facts.default_name} with {text}."
        interval = best.improvement_interval_95
        if verdict(interval) != "better":
            sentence = f"{sentence[:-1]}: the best guess, not known to be better."
    notes: list[str] = []
    silent = {found.path: found.why for found in best.inactive}
    silence = [
        f"{', '.join(parameter_label(p).name for p in silent if silent[p] == why)}: {why}"
        for why in dict.fromkeys(silent.values())
    ]
    return {
        "sentence": sentence,
        "kept": [(parameter_label(p).name, p, _value(values, p), _value(facts.default, p)) for p in kept],
        "rest": ", ".join(
            f"{parameter_label(p).name} {_value(values, p)}" for p in space.paths if p not in kept
        ),
        "notes": notes,
        "silent": silence,
    }


# -- How sure? -----------------------------------------------------------------------------------------------


def pairs(facts: CampaignFacts, best: Recommendation) -> list[Pair]:
    """Every place where the default or the recommended configuration flew, in the settings' order."""
    found: dict[tuple[Any, int], list[list[float]]] = {}
    for side, values in enumerate((best.default_values, best.values)):
        for t in flown(facts, values):
            if t.raw is not None:
                found.setdefault((t.world, t.replicate), [[], []])[side].append(t.raw)
    worlds = list(facts.settings.worlds)
    order = sorted(found, key=lambda place: (worlds.index(place[0]), place[1]))
    return [
        Pair(f"{facts.world_name(w)}, replicate {r}", *(_mean(side) for side in found[w, r]))
        for w, r in order
    ]


def campaign_headline(
    recommendation: Recommendation,
    metric: str,
    difference_unit: str,
    default: str = "paper’s default",
    by: str = "",
) -> str:
    """One honest sentence: better, worse, or no difference detected, with the 95 % interval; ``by`` whom it is said."""
    low, high = recommendation.improvement_interval_95
    digits = decimals_for(recommendation.improvement_sd)
    how = (
        f"improvement {with_unit(recommendation.improvement, difference_unit, digits, signed=True)} "
        f"(95 % interval {format_number(low, digits, signed=True)} to {format_number(high, digits, signed=True)})"
    )
    if recommendation.values == recommendation.default_values:
        return f"The {default} is itself the recommendation: nothing flown so far is believed to be better."
    if recommendation.metric.startswith("costs."):
        how = (
            f"{with_unit(recommendation.mean, difference_unit)} in place of "
            f"{with_unit(recommendation.default_mean, difference_unit)}, {how}"
        )
    kind = verdict(recommendation.improvement_interval_95)
    if kind == "better":
        said = f"The recommended configuration is better than the {default} in {metric}: {how}."
    elif kind == "worse":
        said = f"The recommended configuration is worse than the {default} in {metric}: {how}."
    else:
        said = f"No difference detected between the recommended configuration and the {default} in {metric}: {how}."
    return f"{by}{said[0].lower()}{said[1:]}" if by else said


def limit_text(found: Limit) -> str:
    """One sentence on what has a limit, the limit, and what the default has of it."""
    label = metric_label(found.metric)
    asked = f"{label.full} {'at most' if found.direction == 'minimise' else 'at least'} {with_unit(found.limit, label.unit, 1)}"
    has, of_default = (
        with_unit(mean, label.unit, 1) + ("" if found.exact else f" ± {format_number(sd, 1)}")
        for mean, sd in ((found.mean, found.sd), (found.default_mean, found.default_sd))
    )
    if found.kept:
        chance = "" if found.exact else f" (probability {100 * found.probability:.0f} %)"
        return f"Asked for {asked}: it has {has}{chance}, the default {of_default}."
    return (
        f"No configuration flown keeps {asked}: the likeliest, shown here, has {has}, the default {of_default}; ask for less, "
        "or search further with gatetune campaign resume --missions."
    )


def sure_answer(facts: CampaignFacts) -> list[str]:
    """The verdict with its interval, then on how many rocks it was measured at all."""
    best = facts.recommendation
    if best is None:
        return ["There is nothing to compare."]
    if best.values == best.default_values:
        rocks = len({t.rock for t in flown(facts, best.values)})
        return [
            campaign_headline(best, facts.label.full, "", facts.default_name),
            f"It flew on {rocks} of {len(facts.settings.rocks)} rocks.",
        ]
    unit = facts.label.difference_unit
    by = "Predicted by the low-fidelity simulator: " if is_geometric(facts.settings.fidelity) else ""
    said = [campaign_headline(best, facts.label.full, unit, facts.default_name, by)]
    if best.limit is not None:
        said.append(limit_text(best.limit))
    both = [p for p in pairs(facts, best) if None not in (p.default, p.recommended)]
    rocks = len({p.place.rsplit(", replicate", 1)[0] for p in both})
    of = len(facts.settings.worlds)
    if not both:
        said.append(
            "Predicted, not flown: the recommended configuration and the default never flew the same rock and replicate."
        )
    else:
        sign = facts.sign
        differences = [sign * ((p.recommended or 0.0) - (p.default or 0.0)) for p in both]
        ahead = sum(d > 0 for d in differences)
        mean = with_unit(sum(differences) / len(differences), unit, facts.digits, signed=True)
        said.append(
            f"Flown side by side on {rocks} of {of} {'rocks and conditions' if facts.several_conditions else 'rocks'}"
            f" ({len(both)} {'pair' if len(both) == 1 else 'pairs'}): {mean} on average, better in {ahead} of {len(both)}."
        )
    said.append(
        "The interval is calibrated and of the surrogate, on the rocks that were tuned on, for the best of those flown: it leans "
        "towards optimism."
    )
    if (elsewhere := best.next_rock) is not None:
        digits = _digits(elsewhere.interval_95)
        low, high = (format_number(v, digits, signed=True) for v in elsewhere.interval_95)
        gain = with_unit(elsewhere.gain, unit, digits, signed=True)
        text = f"On a rock nobody has flown: {gain} (95 % interval {low} to {high})."
        said.append(" ".join([text, *elsewhere.warnings()]))
    return said


# -- What did the gate do? -----------------------------------------------------------------------------------


def traces(facts: CampaignFacts, values: Mapping[str, Any]) -> list[tuple[str, list[IterationRecord]]]:
    """Place and choices of every mission of these values whose documents are there."""
    found = []
    for t in flown(facts, values):
        with contextlib.suppress(UserError, OSError):
            trace = MissionResult.load(facts.campaign.directory / t.directory).trace
            if trace:
                found.append((f"{facts.world_name(t.world)} r{t.replicate}", trace))
    return found


def gate_rows(named: Sequence[tuple[str, Sequence[IterationRecord]]]) -> list[GateRow]:
    """The strip: one row per mission."""
    return [GateRow(name, tuple(_choice(record) for record in trace)) for name, trace in named]


def gate_answer(facts: CampaignFacts) -> tuple[str, list[GateRow]]:
    """What the recommended configuration's gate chose, in words, and the strip of its missions and the default's."""
    best = facts.recommendation
    if best is None:
        return "No mission succeeded.", []
    config = facts.settings.config(best.values)
    if isinstance(config, MissionConfig) and config.adaptive_budget == 0:
        return "Nothing: the recommended plan has no planned view.", []
    own = traces(facts, best.values)
    if not own:
        return "The missions' documents hold no choices.", []
    kind = config.gate.kind if isinstance(config, MissionConfig) else ""
    rows = gate_rows(own)
    records = [record for _, trace in own for record in trace]
    text = gate_words(records, [c for row in rows for c in row.choices], strategy_label(kind), len(own))
    if best.values != best.default_values:
        rows = [GateRow(f"rec. {r.name}", r.choices) for r in rows]
        rows += [GateRow(f"def. {r.name}", r.choices) for r in gate_rows(traces(facts, best.default_values))]
    return text, rows


def gate_words(records: Sequence[IterationRecord], choices: Sequence[str], gate: str, missions: int) -> str:
    """Share of each scorer, of equal choices and of switches; or that it never switched."""
    n = len(records)
    counts = collections.Counter(record.scorer for record in records)
    equal = sum(choice == EQUAL for choice in choices)
    where = f"{n} views of {missions} {'mission' if missions == 1 else 'missions'}"
    same = f" In {_share(equal, n)} both scorers had the same best view." if equal else ""
    if len(counts) == 1:
        (scorer,) = counts
        return f"The gate ({gate}) never switched: {strategy_label(scorer)} chose all {where}.{same}"
    shares = ", ".join(f"{strategy_label(s)} {_share(c, n)}" for s, c in counts.most_common())
    following = [(a, b) for a, b in itertools.pairwise(records) if b.iteration == a.iteration + 1]
    switches, steps = sum(a.scorer != b.scorer for a, b in following), len(following)
    return f"{gate} switched in {_share(switches, steps)} of its steps: {shares} of {where}.{same}"


def _choice(record: IterationRecord) -> str:
    views = [best.get("candidate") for best in record.top.values()]
    return EQUAL if len(views) > 1 and len(set(views)) == 1 else record.scorer


# -- What next? ----------------------------------------------------------------------------------------------


def next_answer(facts: CampaignFacts, *, evaluated: bool) -> tuple[str, str]:
    """``(why, command)``: the one thing to do now; an empty command means to stop."""
    best, status = facts.recommendation, facts.status
    run = shlex.quote(str(facts.campaign.directory))
    resume, evaluate = f"gatetune campaign resume {run}", f"gatetune evaluate {run}"
    if best is None:
        reason = max(status.failures, key=lambda r: status.failures[r], default="unknown")
        return f"Every mission failed, most often with {reason!r}: mend that (below), then resume.", resume
    if status.remaining:
        return f"Finish it: {status.remaining} of {status.budget} missions are left.", resume
    if evaluated:
        return "Stop: it has been measured on held-out rocks (below).", ""
    values = use_values(facts)
    if values == facts.default and verdict(best.improvement_interval_95) != "better":
        low, high = best.improvement_interval_95
        if max(abs(low), abs(high)) < best.noise_sd:
            return (
                f"Stop: use the {facts.default_name}. What could still be gained is less than the noise of one mission.",
                "",
            )
        return (
            "Fly more: what could be gained is not yet told from noise.",
            f"{resume} --missions {2 * status.budget}",
        )
    edges = [p for p in at_edge(facts, values) if values[p] != facts.default[p]]
    if edges and facts.settings.mission is None:
        names = ", ".join(parameter_label(p).name for p in edges)
        are = "is at the edge of its range" if len(edges) == 1 else "are at the edges of their ranges"
        return (
            f"Widen a bound: {names} {are}. Copy `search_space` of `campaign.yaml` into widened.yaml, widen it there, and search again.",
            f"gatetune campaign run --space widened.yaml --learn-from {run}",
        )
    if is_geometric(facts.settings.fidelity):
        return "Fly it with photographs, on rocks it has not seen: so far it is a prediction.", evaluate
    both = [p for p in pairs(facts, best) if None not in (p.default, p.recommended)]
    if len(both) < 2 and facts.settings.mission is None:
        return (
            "Confirm it where it was tuned: too few pairs were flown.",
            f"gatetune confirm {run} --rock {shlex.quote(facts.settings.rocks[0])}",
        )
    return "Measure it on rocks it has not seen.", evaluate


def at_edge(facts: CampaignFacts, values: Mapping[str, Any]) -> list[str]:
    """Ordered parameters whose value lies at a bound of the searched range."""
    ordered = [p for p in facts.settings.space.parameters if p.kind != "categorical"]
    return [p.path for p in ordered if not EDGE < p.to_unit(values[p.path]) < 1 - EDGE]


# -- small things --------------------------------------------------------------------------------------------


def measure_text(facts: CampaignFacts) -> str:
    """What every number of the page is: metric with surface, fidelity, condition."""
    s = facts.settings
    if s.mission is not None:
        return f"{facts.label.full}; missions of your mission file, whose instances are called rocks here"
    if is_geometric(s.fidelity):
        fidelity = "predicted by the low-fidelity simulator (geometric missions, no photographs)"
    else:
        fidelity = f"{s.fidelity} missions"
    names = [condition.name for condition in s.conditions]
    worst = "; means and gains are of the worst rock and condition" if s.risk == "worst" else ""
    return f"{facts.label.full}; {fidelity}; {'conditions' if len(names) > 1 else 'condition'} {', '.join(names)}{worst}"


def _value(values: Mapping[str, Any], path: str) -> str:
    return f"{parameter_value(values[path])} {parameter_label(path).unit}".strip()


def _mean(values: Sequence[float]) -> float | None:
    return sum(values) / len(values) if values else None


def _share(part: int, whole: int) -> str:
    return f"{100 * part / whole:.0f} %" if whole else "0 %"


def _digits(interval: tuple[float, float]) -> int:
    return decimals_for((interval[1] - interval[0]) / 4)
