"""Two objectives in a campaign's report: the Pareto front of what was flown."""

from __future__ import annotations

from typing import Any

from tuner.acquisition.two_objectives import pareto_front
from tuner.problem.objective import reached
from tuner.problem.quality_at_cost import COUNTS
from tuner.report.campaign.facts import CampaignFacts
from tuner.report.labels import believed, metric_label, parameter_value, with_unit


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


def front_context(facts: CampaignFacts) -> dict[str, Any] | None:
    """What the page's section needs; None for a campaign with one objective, or without a mission that has both."""
    s = facts.settings
    points = facts.campaign.flown_in_both()
    if s.second is None or not points:
        return None
    front = pareto_front(points, (s.objective, s.second))
    one, two = metric_label(s.objective.metric), metric_label(s.second.metric)
    return {
        "first": one.axis,
        "second": two.axis,
        "rows": [
            [
                believed(p.first, p.first_sd, one),
                believed(p.second, p.second_sd, two),
                *(parameter_value(p.values[path]) for path in s.space.paths),
            ]
            for p in front
        ],
    }
