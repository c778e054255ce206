"""The first screen of a campaign's page: questions, each with an answer that the state of the campaign decides."""

from __future__ import annotations

import contextlib
import shlex
from collections.abc import Mapping
from typing import Any

from nbv.config import MissionConfig
from nbv.errors import UserError
from nbv.mission.result import MissionResult
from nbv.rocks.imported import are_photographed
from tuner.campaign.settings import CampaignSettings
from tuner.evaluation.baselines import label as strategy_label
from tuner.missions.job import Trial
from tuner.missions.registry import is_geometric
from tuner.problem.objective import COUNTS, reached
from tuner.problem.observations import configuration_key
from tuner.problem.search_space import Parameter
from tuner.problem.worlds import World
from tuner.recommendation.recommendation import Recommendation
from tuner.report.answer import (
    LEANS,
    limit_words,
    place_word,
    runner_up_sentence,
    use_sentence,
    value_text,
    worth_sentences,
)
from tuner.report.campaign.facts import CampaignFacts
from tuner.report.labels import metric_label, parameter_label, with_unit
from tuner.report.mission.decisions import gate_words


def asked_text(facts: CampaignFacts) -> str:
    """What the campaign was asked for, in words."""
    s, label = facts.settings, metric_label(facts.settings.objective.metric)
    less = "Fewest" if s.objective.metric in COUNTS else "Lowest"
    full = label.full[:1].lower() + label.full[1:] if less == "Fewest" else label.full
    said = f"{less if s.objective.direction == 'minimise' else 'Highest'} {full}"
    if s.second is None:
        return said
    name = metric_label(s.second.metric).full
    assert s.limit is not None
    if share := reached(s.second.metric):
        of = metric_label(share[0])
        return f"{said} with {of.full} of {of.value(share[1])} on at least {s.limit:g} % of rocks"
    bound = with_unit(s.limit, metric_label(s.second.metric).unit, 0 if s.limit == int(s.limit) else 2)
    return f"{said} with {name} {'at most' if s.second.direction == 'minimise' else 'at least'} {bound}"


def flown(facts: CampaignFacts, values: Mapping[str, Any]) -> list[Trial]:
    """The successful missions of exactly these values."""
    space = facts.settings.space
    key = configuration_key(space, values)
    return [t for t in facts.trials if t.state == "complete" and configuration_key(space, t.values) == key]


def use_answer(facts: CampaignFacts) -> dict[str, Any]:
    """One sentence, the parameters that differ from the default, and what may be better."""
    best, s = facts.recommendation, facts.settings
    if best is None:
        sentence = f"Nothing yet: none of the {facts.status.finished} finished missions succeeded."
        return {"sentence": sentence, "kept": [], "runner_up": ""}
    return {
        "sentence": use_sentence(best, s),
        "kept": [
            (parameter_label(p).name, p, value_text(best.values, p), value_text(facts.default, p))
            for p in best.changed
        ],
        "runner_up": runner_up_sentence(best, s),
    }


def pairs(facts: CampaignFacts, best: Recommendation) -> dict[tuple[World, int], float]:
    """By world and replicate that both flew: the recommendation minus the default, positive where it is better."""
    found: dict[tuple[World, int], list[list[float]]] = {}
    for side, values in enumerate((best.default_values, best.values)):
        for t in flown(facts, values):
            if (outcome := facts.outcome(t)) is not None:
                found.setdefault((t.world, t.replicate), [[], []])[side].append(facts.sign * outcome)
    return {
        place: sum(ours) / len(ours) - sum(theirs) / len(theirs)
        for place, (theirs, ours) in found.items()
        if ours and theirs
    }


def sure_answer(facts: CampaignFacts) -> list[str]:
    """What it is worth, then on how many rocks that was measured at all."""
    best = facts.recommendation
    if best is None:
        return ["There is nothing to compare."]
    said, place = worth_sentences(best, facts.settings), place_word(facts.settings)
    if best.keep_default:
        rocks = len({t.rock for t in flown(facts, best.values)})
        return [*said, f"It flew on {rocks} of {len(facts.settings.rocks)} {place}s."]
    both = pairs(facts, best)
    if not both:
        said.append(
            f"Never flown side by side: no {place} and replicate has both the recommendation and the default."
        )
        return [*said, LEANS]
    mean = with_unit(sum(both.values()) / len(both), facts.label.difference_unit, facts.digits, signed=True)
    said.append(
        f"Flown side by side on {len({world for world, _ in both})} of {len(facts.settings.worlds)} {place}s"
        f"{' and conditions' if facts.several_conditions else ''} ({len(both)} {'pair' if len(both) == 1 else 'pairs'}): "
        f"{mean} of {facts.label.name} on average, better in {sum(d > 0 for d in both.values())} of {len(both)}."
    )
    return [*said, LEANS]


def gate_answer(facts: CampaignFacts) -> str:
    """What the recommended configuration's gate chose, from its missions' traces."""
    best = facts.recommendation
    if best is None:
        return "No mission succeeded."
    config = facts.settings.config(best.values)
    if not isinstance(config, MissionConfig) or config.adaptive_budget == 0:
        return "Nothing: the recommended plan has no planned view."
    traces = []
    for t in flown(facts, best.values):
        with contextlib.suppress(UserError, OSError):
            traces.append(MissionResult.load(facts.campaign.directory / t.directory).trace)
    traces = [trace for trace in traces if trace]
    records = [record for trace in traces for record in trace]
    if not records:
        return "The missions' documents hold no choices."
    return gate_words(records, strategy_label(config.gate.kind), len(traces))


def next_answer(facts: CampaignFacts, *, evaluated: bool) -> tuple[str, str]:
    """``(why, command)``: the one thing to do now; an empty command means to stop."""
    best, status, place = facts.recommendation, facts.status, place_word(facts.settings)
    run = shlex.quote(str(facts.campaign.directory))
    resume, evaluate, confirm = (f"gatetune {c} {run}" for c in ("campaign resume", "evaluate", "confirm"))
    if facts.settings.draws_rocks:  # as many of every family as are worth an interval
        evaluate += "".join(f" --rock {rock}" for rock in facts.settings.rocks)
    more = f"{resume} --missions {2 * status.budget}"
    if best is None:
        reason = max(status.failures, key=lambda r: status.failures[r], default="unknown")
        return f"Every mission failed, most often with {reason!r}: mend that (below), then resume.", resume
    if status.remaining:
        return f"Finish it: {status.remaining} of {status.budget} missions are left.", resume
    if evaluated:
        return f"Stop: it has been measured on held-out {place}s.", ""
    if best.limit is not None and not best.limit.kept:
        return f"Fly more, or ask for less: nothing flown is likely to keep {limit_words(best.limit)}.", more
    if best.keep_default:
        rival = best.runner_up
        if rival is None or (not best.exact and rival.improvement_interval_95[1] < best.noise_sd):
            return "Stop: keep the default. Nothing else is believed to be better.", ""
        return "Fly more: the runner-up is not yet told from the default.", more
    if is_geometric(facts.settings.fidelity):
        return "Fly it with photographs, on rocks it has not seen: so far it is a prediction.", evaluate
    if facts.settings.mission is not None and not facts.settings.mission.held_out:
        return "Confirm it with fresh replicates: your mission file holds no instance out.", confirm
    if facts.settings.mission is None and len(pairs(facts, best)) < 2:
        one_rock = f"{confirm} --rock {shlex.quote(facts.settings.rocks[0])}"
        return "Confirm it where it was tuned: too few pairs were flown.", one_rock
    return f"Measure it on {place}s it has not seen.", evaluate


def bounds_text(facts: CampaignFacts) -> str:
    """Which recommended values lie at a bound of what was searched, although a mission can fly beyond; empty where none does."""
    best, s = facts.recommendation, facts.settings
    if best is None:
        return ""
    names = [
        parameter_label(p.path).name
        for p in s.space.parameters
        if p.path in best.changed and p.kind != "categorical" and _ends_too_early(s, p, best.values)
    ]
    if not names:
        return ""
    return (
        f"At a bound of what was searched: {', '.join(names)}. A wider search space may have better values."
    )


def _ends_too_early(s: CampaignSettings, p: Parameter, values: Mapping[str, Any]) -> bool:
    if values[p.path] not in p.ends:
        return False
    step = 0.1 * (p.high - p.low) * (1 if values[p.path] == p.high else -1)
    beyond = values[p.path] + step if p.kind == "float" else round(values[p.path] + step)
    try:
        s.config({**values, p.path: beyond})
    except UserError:
        return s.mission is not None  # which allows what it lists alone
    return True


def measure_text(facts: CampaignFacts) -> str:
    """What every number of the page is: metric with surface, fidelity, condition."""
    s = facts.settings
    if s.mission is not None:
        return f"{facts.label.full}; missions of your mission file"
    fidelity = f"{s.fidelity} missions"
    if is_geometric(s.fidelity):
        fidelity = "predicted by the low-fidelity simulator (geometric missions, no photographs)"
    if are_photographed(s.rocks):
        return f"{facts.label.full}, against the set's own dense reference; missions over photographs that were taken"
    names = [condition.name for condition in s.conditions]
    return f"{facts.label.full}; {fidelity}; {'conditions' if len(names) > 1 else 'condition'} {', '.join(names)}"
