"""The campaign page's tables, row by row, as text."""

from __future__ import annotations

import collections
from collections.abc import Sequence

from tuner.missions.job import Trial
from tuner.missions.registry import is_geometric
from tuner.recommendation.recommendation import Recommendation
from tuner.report.answer import exact_text
from tuner.report.campaign.facts import CampaignFacts
from tuner.report.labels import format_number, metric_label, parameter_value
from tuner.report.pages import duration

_KEY_FIGURES_OF_ANY_MISSION = 3  # the others are of flights and photographs
_STAGES = 3  # of a mission that are named


def key_figures(facts: CampaignFacts) -> list[tuple[str, str]]:
    """The figures at the head of the page, each with what it is."""
    st = facts.status
    return [
        (f"{st.finished} of {st.budget}", "missions finished"),
        (f"{st.failed}, {_degraded(facts)}", "of them failed, degraded"),
        (duration(st.mission_wall_s), "computing, summed over missions"),
        (duration(facts.total("flight_time_s")), "simulated flight"),
        (_distance(facts.total("path_length_m")), "flown"),
        (f"{facts.total('images'):.0f}", _photographs(facts)),
    ][: None if facts.settings.mission is None else _KEY_FIGURES_OF_ANY_MISSION]


def rock_rows(facts: CampaignFacts, best: Recommendation) -> list[list[str]]:
    """Rock by rock, condition by condition: missions, failures, what the recommendation and the default had there."""
    rows = []
    done = [t for t in facts.trials if t.state != "running"]
    for row in best.per_rock:
        own = [t for t in done if t.world == row.world]
        with_default = [t for t in own if t.values == best.default_values and facts.outcome(t) is not None]
        rows.append(
            [
                facts.rock_names[row.rock],
                *facts.condition_cells(row.world),
                str(len(own)),
                str(sum(t.raw is None for t in own)),
                str(row.missions),
                format_number(facts.label.possible(row.predicted), facts.digits),
                format_number(row.observed, facts.digits),
                str(len(with_default)),
                format_number(_mean([facts.outcome(t) for t in with_default]), facts.digits),
            ]
        )
    return rows


def longest_stages(facts: CampaignFacts) -> str:
    """The stages that took most of the missions' time; empty where missions recorded none."""
    totals: dict[str, float] = collections.defaultdict(float)
    for trial in facts.trials:
        for stage, value in trial.timings_s.items():
            if "." not in stage and stage != "total" and isinstance(value, (int, float)):
                totals[stage] += value
    whole = sum(totals.values())
    longest = sorted(totals, key=lambda stage: -totals[stage])[:_STAGES]
    return ", ".join(f"{stage} {100 * totals[stage] / whole:.0f} %" for stage in longest if totals[stage] > 0)


def failure_rows(facts: CampaignFacts) -> list[list[str]]:
    """Failed and degraded missions by reason, the commonest first: how many, on which rocks, the last one's message."""
    groups: dict[tuple[str, str], list[Trial]] = collections.defaultdict(list)
    for t in facts.trials:
        if t.state == "failed" or t.status == "degraded":
            outcome = "failed" if t.state == "failed" else "degraded"
            groups[t.reason or "unknown", outcome].append(t)
    separator = "; " if facts.several_conditions else ", "
    return [
        [
            reason,
            outcome,
            str(len(group)),
            separator.join(sorted({facts.world_name(t.world) for t in group})),
            group[-1].message,
        ]
        for (reason, outcome), group in sorted(groups.items(), key=lambda item: -len(item[1]))
    ]


def trial_row(facts: CampaignFacts, t: Trial) -> list[str]:
    """One mission: where it flew, what it measured, its configuration."""
    outcome = {
        "running": "in flight",
        "complete": " ".join(filter(None, (t.status or "ok", t.reason))),
        "failed": f"failed: {t.reason}",
    }[t.state]
    return [
        str(t.number + 1),
        str(t.why.get("phase", "")),
        facts.rock_names.get(t.rock, t.rock),
        *facts.condition_cells(t.world),
        str(t.replicate),
        format_number(facts.outcome(t), facts.digits),
        *_cost_cell(facts, t),
        outcome,
        *(parameter_value(t.values[path]) for path in facts.settings.space.paths),
    ]


def _cost_cell(facts: CampaignFacts, t: Trial) -> list[str]:
    """The objective where the configuration decides it; no cell elsewhere."""
    objective = facts.settings.objective
    if facts.modelled == objective:
        return []
    return ["–" if t.raw is None else exact_text(t.raw, metric_label(objective.metric))]


def _mean(values: Sequence[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return sum(known) / len(known) if known else None


def _degraded(facts: CampaignFacts) -> int:
    return sum(t.state == "complete" and t.status == "degraded" for t in facts.trials)


def _photographs(facts: CampaignFacts) -> str:
    return "captures, no photographs" if is_geometric(facts.settings.fidelity) else "photographs"


def _distance(metres: float) -> str:
    return f"{metres:.0f} m" if metres < 2000 else f"{metres / 1000:.1f} km"
