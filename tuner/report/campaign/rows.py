"""The campaign page's tables, row by row, as text."""

from __future__ import annotations

import collections

from tuner.missions.job import Trial
from tuner.recommendation.recommendation import Recommendation
from tuner.report.campaign.facts import CampaignFacts
from tuner.report.labels import format_number
from tuner.report.pages import duration


def progress_text(facts: CampaignFacts) -> str:
    """``12 of 12 missions finished, 1 failed, 0 degraded; 7 min of computing.``"""
    st = facts.status
    degraded = sum(t.state == "complete" and t.status == "degraded" for t in facts.trials)
    return (
        f"{st.finished} of {st.budget} missions finished, {st.failed} failed, {degraded} degraded; "
        f"{duration(st.mission_wall_s)} of computing."
    )


def rock_rows(facts: CampaignFacts, best: Recommendation) -> list[list[str]]:
    """World by world: missions, failures, what the recommendation and the default had there, with their missions."""
    rows = []
    done = [t for t in facts.trials if t.state != "running"]
    for row in best.per_rock:
        own = [t for t in done if t.world == row.world]
        outcomes = [facts.outcome(t) for t in own if t.values == best.default_values]
        default = [value for value in outcomes if value is not None]
        rows.append(
            [
                facts.world_name(row.world),
                str(len(own)),
                str(sum(t.raw is None for t in own)),
                format_number(facts.label.possible(row.predicted), facts.digits),
                _measured(row.observed, row.missions, facts.digits),
                _measured(sum(default) / len(default) if default else None, len(default), facts.digits),
            ]
        )
    return rows


def failure_rows(facts: CampaignFacts) -> list[list[str]]:
    """Failed and degraded missions by reason, the commonest first: how many, on which rocks, the last one's message."""
    groups: dict[tuple[str, str], list[Trial]] = collections.defaultdict(list)
    for t in facts.trials:
        if t.state == "failed" or t.status == "degraded":
            outcome = "failed" if t.state == "failed" else "degraded"
            groups[t.reason or "unknown", outcome].append(t)
    return [
        [
            reason,
            outcome,
            str(len(group)),
            "; ".join(sorted({facts.world_name(t.world) for t in group})),
            group[-1].message,
        ]
        for (reason, outcome), group in sorted(groups.items(), key=lambda item: -len(item[1]))
    ]


def _measured(mean: float | None, missions: int, digits: int) -> str:
    return f"{format_number(mean, digits)} ({missions})" if missions else format_number(None)
