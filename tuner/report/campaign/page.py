"""``report.html`` of a campaign: one self-contained page for the person who has to believe it."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import Any

import yaml

from nbv.config import IDEAL
from nbv.errors import UserError
from nbv.provenance import git_revision, versions
from tuner.campaign.campaign import Campaign
from tuner.campaign.settings_file import SETTINGS_FILE
from tuner.campaign.shipped import SHIPPED
from tuner.campaign.showcase import SHOWN
from tuner.missions.registry import GEOMETRIC_NOTE, ignored_by, is_geometric
from tuner.problem.search_space import ours
from tuner.recommendation.recommendation import Recommendation
from tuner.report.answer import place_word
from tuner.report.campaign.answers import (
    gate_answer,
    measure_text,
    next_answer,
    sure_answer,
    use_answer,
)
from tuner.report.campaign.explorer import MOST_MISSIONS, explorer_data
from tuner.report.campaign.facts import CampaignFacts
from tuner.report.campaign.front import asked_text, front_context
from tuner.report.campaign.plan_picture import plan_picture
from tuner.report.campaign.provenance import command_note, provenance_rows, reproduce_command
from tuner.report.campaign.rows import failure_rows, progress_text, rock_rows
from tuner.report.campaign.walks import PAGE, REPORT_FILE, linked_comparisons
from tuner.report.campaign.wider import write_wider_settings
from tuner.report.labels import parameter_label, verdict, with_unit
from tuner.report.pages import write_page

# Coverage of 95 % intervals below which the page says that they are too narrow.
POOR_COVERAGE = 0.85
MIN_MISSIONS_FOR_COVERAGE = 12


def write_campaign_report(campaign: Campaign) -> Path:
    """Write ``report.html`` and settings to search on with into the campaign's run directory; the path of the page.

    The campaign may be finished, interrupted or still running.

    Raises
    ------
    UserError
        The campaign has no finished mission, or the directory cannot be written.
    """
    facts = CampaignFacts(campaign)
    if facts.status.finished == 0:
        raise UserError(f"{campaign.directory} has no finished mission; run or resume the campaign first")
    try:
        if facts.recommendation is not None:
            write_wider_settings(campaign, facts.recommendation)
        context = _context(facts)
    except OSError as error:
        raise UserError(
            f"cannot write to {campaign.directory}: {error.strerror}; choose another directory"
        ) from error
    return write_page(campaign.directory / REPORT_FILE, "campaign.html.j2", **context)


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
        "progress": progress_text(facts),
        "place": place_word(s),
        "recommended": best is not None,
        "several_conditions": facts.several_conditions,
        "parameters": [(path, parameter_label(path).short) for path in s.space.paths],
        "metric": facts.label.full,
        "unit": facts.label.unit,
        "not_drawn": max(0, len(facts.trials) - MOST_MISSIONS),
        "explorer": explorer_data(facts),
        "model": "" if best is None or facts.model is None else _model_text(facts, best),
        "per_rock": [] if best is None else rock_rows(facts, best),
        "front": front_context(facts),
        "failures": failure_rows(facts),
        "run": shlex.quote(str(facts.campaign.directory)),
        "command": reproduce_command(facts.campaign),
        "command_note": command_note(facts.campaign),
        "provenance": provenance_rows(facts),
        "settings_file": SETTINGS_FILE,
        "settings_yaml": yaml.safe_dump(s.to_dict(), sort_keys=False, allow_unicode=True),
        "version": versions().get("gatetune", ""),
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
    degraded = sum(t.status == "degraded" for t in facts.trials)
    for count, what in ((degraded, "were degraded"), (status.failed, "failed")):
        if count > 0.2 * status.finished:
            out.append(f"{count} of {status.finished} finished missions {what}; see below.")
    return out
