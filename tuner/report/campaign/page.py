"""``report.html`` of a campaign: one self-contained page for the person who has to believe it."""

from __future__ import annotations

import collections
import shlex
from pathlib import Path
from typing import Any

import yaml

from nbv.config import IDEAL
from nbv.errors import UserError
from nbv.provenance import git_revision
from tuner.campaign.campaign import Campaign
from tuner.campaign.settings_file import SETTINGS_FILE
from tuner.campaign.shipped import SHIPPED
from tuner.campaign.showcase import SHOWN
from tuner.missions.job import Trial
from tuner.missions.registry import GEOMETRIC_NOTE, ignored_by, is_geometric
from tuner.problem.search_space import ours
from tuner.recommendation.recommendation import Recommendation
from tuner.report.answer import place_word
from tuner.report.campaign.answers import (
    asked_text,
    bounds_text,
    gate_answer,
    measure_text,
    next_answer,
    sure_answer,
    use_answer,
)
from tuner.report.campaign.explorer import MOST_MISSIONS, explorer_data
from tuner.report.campaign.facts import CampaignFacts
from tuner.report.campaign.plan_picture import plan_picture
from tuner.report.campaign.provenance import command_note, provenance_rows, reproduce_command
from tuner.report.campaign.walks import PAGE, REPORT_FILE, linked_comparisons
from tuner.report.labels import format_number, verdict, with_unit
from tuner.report.pages import duration, write_page

# Coverage of 95 % intervals below which the page says that they are too narrow.
POOR_COVERAGE = 0.85
MIN_MISSIONS_FOR_COVERAGE = 12


def write_campaign_report(campaign: Campaign) -> Path:
    """Write ``report.html`` into the campaign's run directory; the path of the page.

    The campaign may be finished, interrupted or still running.

    Raises
    ------
    UserError
        The campaign has no finished mission, or the directory cannot be written.
    """
    facts = CampaignFacts(campaign)
    if facts.status.finished == 0:
        raise UserError(f"{campaign.directory} has no finished mission; run or resume the campaign first")
    return write_page(campaign.directory / REPORT_FILE, "campaign.html.j2", **_context(facts))


def _context(facts: CampaignFacts) -> dict[str, Any]:
    """What the template needs."""
    s, best = facts.settings, facts.recommendation
    conditions = [condition.name for condition in s.conditions]
    under = "" if conditions == [IDEAL] else f"; under {', '.join(conditions)}"
    measured = linked_comparisons(facts.campaign)
    why, command = next_answer(facts, evaluated=any(name.startswith("evaluation") for name, _ in measured))
    better = best is not None and not best.keep_default and (best.limit is None or best.limit.kept)
    plan = best is not None and s.mission is None
    return {
        "title": f"{s.name} · gatetune campaign",
        "name": f"Campaign {s.name}",
        "subtitle": f"{asked_text(facts)}, on {', '.join(facts.rock_names.values())}{under}; "
        f"{s.space.dimension} parameters tuned (search space {s.space.name})",
        "measure": measure_text(facts),
        "verdict_kind": verdict(best.improvement_interval_95).split()[0] if best and better else "",
        "use": use_answer(facts),
        "plan": plan_picture(ours(s.config(best.values))) if best is not None and plan else "",
        "sure": sure_answer(facts),
        "gate": gate_answer(facts) if s.mission is None else "",
        "measured": measured,
        "next_why": why,
        "next_command": command,
        "walk": f"{SHOWN}/{PAGE}" if (facts.campaign.directory / SHOWN / PAGE).is_file() else "",
        "warnings": _warnings(facts),
        "progress": _progress_text(facts),
        "place": place_word(s),
        "recommended": best is not None,
        "several_conditions": facts.several_conditions,
        "metric": facts.label.full,
        "unit": facts.label.unit,
        "not_drawn": max(0, len(facts.trials) - MOST_MISSIONS),
        "explorer": explorer_data(facts),
        "model": "" if best is None or facts.model is None else _model_text(facts, best),
        "per_rock": [] if best is None else _rock_rows(facts, best),
        "failures": _failure_rows(facts),
        "run": shlex.quote(str(facts.campaign.directory)),
        "command": reproduce_command(facts.campaign),
        "command_note": command_note(facts.campaign),
        "provenance": provenance_rows(facts),
        "settings_file": SETTINGS_FILE,
        "settings_yaml": yaml.safe_dump(s.to_dict(), sort_keys=False, allow_unicode=True),
        "revision": git_revision(),
    }


def _model_text(facts: CampaignFacts, best: Recommendation) -> str:
    """What the surrogate is of, its noise, and whether its intervals hold."""
    place, earlier = place_word(facts.settings), facts.campaign.learned
    said = (
        f"A Gaussian process on {best.observations} missions. One mission scatters about its configuration’s mean over "
        f"{place}s with a standard deviation of "
        f"{with_unit(best.noise_sd, facts.label.difference_unit, facts.digits)}."
    )
    if best.observations > 1:
        said += (
            f" Predicted from all the others, {100 * best.leave_one_out['coverage_95']:.0f} % of the missions lie "
            "inside their 95 % interval."
        )
    if earlier is not None:
        sources = ["shipped with this program" if s == SHIPPED else s for s in facts.settings.sources]
        said += (
            f" It began with what {len(earlier.observations)} missions of earlier campaigns taught "
            f"({', '.join(sources)}; on {', '.join(Path(r).stem for r in earlier.rocks)})."
        )
    return said


def _warnings(facts: CampaignFacts) -> list[str]:
    best, s, status = facts.recommendation, facts.settings, facts.status
    out = []
    if is_geometric(s.fidelity):
        ignored = ignored_by(s.fidelity, s.conditions)
        out.append(f"{GEOMETRIC_NOTE} They rank configurations and do not measure them. {ignored}")
    if status.remaining:
        out.append(facts.stop_reason)
    if best is not None and best.observations < MIN_MISSIONS_FOR_COVERAGE:
        out.append(
            f"Only {best.observations} successful missions: the model rests mostly on its priors, and its intervals "
            "cannot be checked yet."
        )
    elif best is not None and (coverage := best.leave_one_out["coverage_95"]) < POOR_COVERAGE:
        out.append(
            f"The model’s 95 % intervals held only {100 * coverage:.0f} % of the left-out missions: read all "
            "intervals on this page as too narrow."
        )
    if at_bounds := bounds_text(facts):
        out.append(at_bounds)
    degraded = sum(t.status == "degraded" for t in facts.trials)
    for count, what in ((degraded, "were degraded"), (status.failed, "failed")):
        if count > 0.2 * status.finished:
            out.append(f"{count} of {status.finished} finished missions {what}; see below.")
    return out


def _progress_text(facts: CampaignFacts) -> str:
    """``12 of 12 missions finished, 1 failed, 0 degraded; 7 min of computing.``"""
    st = facts.status
    degraded = sum(t.state == "complete" and t.status == "degraded" for t in facts.trials)
    return (
        f"{st.finished} of {st.budget} missions finished, {st.failed} failed, {degraded} degraded; "
        f"{duration(st.mission_wall_s)} of computing."
    )


def _rock_rows(facts: CampaignFacts, best: Recommendation) -> list[list[str]]:
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


def _failure_rows(facts: CampaignFacts) -> list[list[str]]:
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
