"""``report.html`` of a campaign: one self-contained page for the person who has to believe it."""

from __future__ import annotations

import shlex
from collections.abc import Mapping
from pathlib import Path
from typing import Any
from urllib.parse import quote

import yaml

from nbv.config import IDEAL
from nbv.errors import UserError
from nbv.provenance import git_revision, versions
from tuner.campaign.campaign import Campaign
from tuner.campaign.settings_file import SETTINGS_FILE
from tuner.campaign.shipped import SHIPPED
from tuner.campaign.showcase import SHOWN
from tuner.missions.registry import GEOMETRIC_NOTE, ignored_by, is_geometric
from tuner.problem.search_space import SearchSpace, ours
from tuner.recommendation.recommendation import Recommendation
from tuner.report.answer import place_word
from tuner.report.campaign.answers import (
    gate_answer,
    measure_text,
    next_answer,
    sure_answer,
    use_answer,
)
from tuner.report.campaign.explorer import MOST_MISSIONS, explorer_data, mission_link
from tuner.report.campaign.facts import CampaignFacts
from tuner.report.campaign.front import asked_text, front_context
from tuner.report.campaign.plan_picture import plan_picture
from tuner.report.campaign.provenance import command_note, provenance_rows, reproduce_command
from tuner.report.campaign.rows import (
    failure_rows,
    key_figures,
    longest_stages,
    rock_rows,
    trial_row,
)
from tuner.report.campaign.vehicle_files import vehicle_files
from tuner.report.campaign.walks import PAGE, REPORT_FILE, linked_comparisons
from tuner.report.campaign.wider import write_wider_settings
from tuner.report.labels import (
    believed,
    metric_label,
    parameter_label,
    parameter_value,
    verdict,
    with_unit,
)
from tuner.report.pages import write_page

MOST_ROWS = 500  # of missions in the table
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


def values_yaml(values: Mapping[str, Any], space: SearchSpace) -> str:
    """A configuration's values as parameter paths, to the last digit: what was flown."""
    return yaml.safe_dump(space.complete(values), sort_keys=False)


# -- what the template needs ---------------------------------------------------------------------------------


def _context(facts: CampaignFacts) -> dict[str, Any]:
    s, label = facts.settings, facts.label
    best = facts.recommendation
    rocks = ", ".join(facts.rock_names.values())
    context: dict[str, Any] = {
        "title": f"{s.name} · gatetune campaign",
        "name": f"Campaign {s.name}",
        "subtitle": f"{asked_text(facts)}, on {rocks}{_under_conditions(facts)}; "
        f"{s.space.dimension} parameters tuned (search space "
        f"{s.space.name})",
        "warnings": _warnings(facts),
        "kpis": key_figures(facts),
        "ours": s.mission is None,
        "place": place_word(s),
        "recommended": best is not None,
        "parameters": [(path, parameter_label(path).short) for path in s.space.paths],
        "metric_name": label.name,
        "metric_full": label.full,
        "unit": label.unit,
        "stop_reason": facts.stop_reason,
        "stages": longest_stages(facts),
        "failures": failure_rows(facts),
        "cost_name": "" if facts.modelled == s.objective else metric_label(s.objective.metric).axis,
        "trials": [(mission_link(facts, t), trial_row(facts, t)) for t in facts.trials[-MOST_ROWS:]],
        "left_out": max(0, len(facts.trials) - MOST_ROWS),
        "not_drawn": max(0, len(facts.trials) - MOST_MISSIONS),
        "run": shlex.quote(str(facts.campaign.directory)),
        "command": reproduce_command(facts.campaign),
        "command_note": command_note(facts.campaign),
        "provenance": provenance_rows(facts),
        "settings_file": SETTINGS_FILE,
        "settings_yaml": yaml.safe_dump(s.to_dict(), sort_keys=False, allow_unicode=True),
        "version": versions().get("gatetune", ""),
        "revision": git_revision(),
        "several_conditions": facts.several_conditions,
        "per_rock": [],
        "top": [],
        "model_text": "",
        "front": front_context(facts),
        "explorer": explorer_data(facts),
        "walk": f"{SHOWN}/{PAGE}" if (facts.campaign.directory / SHOWN / PAGE).is_file() else "",
        **_answers(facts),
    }
    if best is not None:
        context |= _recommended_context(facts, best)
        if facts.model is not None:
            context["model_text"] = _model_text(facts, best)
    return context


def _answers(facts: CampaignFacts) -> dict[str, Any]:
    """The first screen."""
    best = facts.recommendation
    measured = linked_comparisons(facts.campaign)
    why, command = next_answer(facts, evaluated=any(name.startswith("evaluation") for name, _ in measured))
    use = use_answer(facts)
    better = best is not None and not best.keep_default and (best.limit is None or best.limit.kept)
    return {
        "measure": measure_text(facts),
        "verdict_kind": verdict(best.improvement_interval_95).split()[0] if best and better else "",
        "use": use,
        **_plan(facts),
        "sure": sure_answer(facts),
        "gate": gate_answer(facts),
        "measured": measured,
        "next_why": why,
        "next_command": command,
        "files": [] if best is None else _files(facts, best),
    }


def _plan(facts: CampaignFacts) -> dict[str, Any]:
    """The recommended plan as a picture; nothing for a mission that is not ours."""
    best, s = facts.recommendation, facts.settings
    if best is None or s.mission is not None:
        return {"plan": "", "planned": False}
    config = ours(s.config(best.values))
    return {"plan": plan_picture(config), "planned": config.adaptive_budget > 0}


def _files(facts: CampaignFacts, best: Recommendation) -> list[dict[str, Any]]:
    """The configuration to use as files, each with what does not transfer."""
    s, values = facts.settings, best.values
    written = [("configuration.yaml", values_yaml(values, s.space), list[str](), "everything")]
    if s.mission is None:
        files = vehicle_files(facts.campaign, best)
        written += [(f.name, f.text, list(f.remarks), f.share) for f in files if f.useful]
    return [
        {
            "name": name,
            "text": text,
            "address": f"data:text/yaml;charset=utf-8,{quote(text)}",
            "lost": lost,
            "note": f"carries {share}",
        }
        for name, text, lost, share in written
    ]


def _earlier_text(facts: CampaignFacts) -> str:
    earlier = facts.campaign.learned
    if earlier is None:
        return ""
    sources = ["shipped with this program" if s == SHIPPED else s for s in facts.settings.sources]
    return (
        f" It began with what {len(earlier.observations)} missions of earlier campaigns taught "
        f"({', '.join(sources)}; on {', '.join(Path(r).stem for r in earlier.rocks)})."
    )


def _under_conditions(facts: CampaignFacts) -> str:
    names = [condition.name for condition in facts.settings.conditions]
    return "" if names == [IDEAL] else f"; under {', '.join(names)}"


def _recommended_context(facts: CampaignFacts, best: Recommendation) -> dict[str, Any]:
    s = facts.settings
    return {
        "per_rock": rock_rows(facts, best),
        "top_name": metric_label(best.metric).axis,
        "top": [
            {
                "mean": believed(c.mean, c.sd, metric_label(best.metric)),
                "keeps": "" if c.probability is None else f"{c.probability:.2f}",
                "missions": f"{c.missions} ({c.failed})" if c.failed else str(c.missions),
                "parameters": [parameter_value(c.values[path]) for path in s.space.paths],
                "recommended": c.values == best.values,
            }
            for c in best.top
        ],
    }


def _model_text(facts: CampaignFacts, best: Recommendation) -> str:
    unit, place = facts.label.difference_unit, place_word(facts.settings)
    shared = (
        ""
        if best.block_sd is None
        else f" What all missions on one {place} and replicate share is modelled apart and cancels between configurations; its "
        f"standard deviation is {with_unit(best.block_sd, unit, facts.digits)}."
    )
    exact = (
        f" {metric_label(best.metric).name} is no part of it: the configuration decides it."
        if best.exact
        else ""
    )
    trend = ", beside a linear trend" if facts.model is not None and facts.model.settings.trend else ""
    check = best.leave_one_out
    checked = (
        f" Predicted from all the others, {100 * check['coverage_95']:.0f} % of the missions lie inside their 95 % interval; "
        f"the residuals’ standard deviation is {check['z_sd']:.2f} predicted ones (ideal: 1)."
        if best.observations > 1
        else ""
    )
    return (
        f"A Gaussian process (Matérn 5/2, one length scale per parameter{trend}) of {facts.label.full} on "
        f"{best.observations} missions, outcomes standardised per {place}{' and condition' if facts.several_conditions else ''}."
        f"{exact} One mission scatters about its configuration’s mean over {place}s with a standard deviation of "
        f"{with_unit(best.noise_sd, unit, facts.digits)}: that is the noise against which differences have to be seen."
        f"{checked}{shared}{_earlier_text(facts)}"
    )


def _warnings(facts: CampaignFacts) -> list[str]:
    best, s = facts.recommendation, facts.settings
    out = []
    if is_geometric(s.fidelity):
        ignored = ignored_by(s.fidelity, s.conditions)
        out.append(f"{GEOMETRIC_NOTE} They rank configurations and do not measure them. {ignored}")
    if facts.status.remaining and best is not None:
        out.append(f"The campaign is not finished. {facts.stop_reason}")
    if best is None:
        return out
    coverage = best.leave_one_out["coverage_95"]
    if best.observations < MIN_MISSIONS_FOR_COVERAGE:
        out.append(
            f"Only {best.observations} successful missions: the model rests mostly on its priors, and its intervals "
            "cannot be checked yet."
        )
    elif coverage < POOR_COVERAGE:
        out.append(
            f"The model’s 95 % intervals held only {100 * coverage:.0f} % of the left-out missions: read all "
            "intervals on this page as too narrow."
        )
    if (degraded := sum(t.status == "degraded" for t in facts.trials)) > 0.2 * facts.status.finished:
        out.append(f"{degraded} of {facts.status.finished} finished missions were degraded; see Costs.")
    if facts.status.failed > 0.2 * facts.status.finished:
        out.append(f"{facts.status.failed} of {facts.status.finished} finished missions failed; see Costs.")
    return out
