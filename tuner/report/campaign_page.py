"""``report.html`` of a campaign: one self-contained page, with the evidence."""

from __future__ import annotations

import collections
import math
import shlex
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from nbv.config import IDEAL, MissionConfig
from nbv.errors import UserError
from nbv.mission.run_directory import RESULT
from nbv.provenance import git_revision
from nbv.safe_files import to_yaml
from tuner.campaign.campaign import Campaign
from tuner.campaign.events import CampaignStatus
from tuner.campaign.session import MAX_CONSECUTIVE_FAILURES, REFUSED
from tuner.campaign.settings import CampaignSettings
from tuner.campaign.settings_file import SETTINGS_FILE
from tuner.campaign.shipped import SHIPPED
from tuner.campaign.showcase import SHOWN, showcase_jobs, was_run
from tuner.comparison.advice import advice_of, next_step
from tuner.comparison.result import all_results
from tuner.missions.job import Trial
from tuner.problem.instances import Instance
from tuner.problem.objective import COUNTS
from tuner.problem.search_space import Parameter
from tuner.recommendation.recommendation import Recommendation
from tuner.report.answer import (
    advice_lines,
    bound,
    changed_table,
    gate_sentences,
    next_text,
    rock_table,
    worth_sentences,
)
from tuner.report.comparison import REPORT_FILE, earned_sentences, legend_of, results_table
from tuner.report.figures import draw_outcomes, draw_slices, plan_figure
from tuner.report.labels import (
    decimals_for,
    duration,
    measure_text,
    metric_label,
    parameter_label,
    short_names,
    with_unit,
)
from tuner.report.mission_view import write_mission_view
from tuner.report.pages import recorded, recorded_rows, write_page
from tuner.report.style import embed
from tuner.report.table import Table

VIEW_FILE = "view.html"
NEAR_A_BOUND = 0.01  # of the range
BEYOND = (0.1, 0.02)  # of the range: how far beyond a bound a mission is tried


def write_campaign_report(campaign: Campaign) -> Path:
    """Write ``report.html`` into the campaign's run directory; the path of the page.

    The campaign may be finished, interrupted or still running.

    Raises
    ------
    UserError
        The campaign has no finished mission, or the directory cannot be written.
    """
    s, status, trials, directory = campaign.settings, campaign.status(), campaign.trials(), campaign.directory
    if status.finished == 0:
        raise UserError(f"{directory} has no finished mission; run or resume the campaign first")
    # The recommendation after all finished missions, the same as in status, export and evaluation.
    best = campaign.recommendation(save=False)
    advice = None if best is None else advice_of(campaign, best)
    advised = [f"Nothing yet: {campaign.nothing_yet()}."]
    if best is not None and advice is not None:
        advised = advice_lines(advice, best, s)
    label, word = metric_label(s.goal.shown.metric), s.problem.instance_word
    names = _instance_names(s)
    measured = sorted(
        page.parent.name
        for what in ("evaluation*", "confirmation*")
        for page in directory.glob(f"{what}/{REPORT_FILE}")
    )
    why, command = next_text(next_step(campaign, best, advice), campaign, advice)
    results = all_results(campaign, best)
    kind = ""
    if best is not None and not best.keep_default and (best.limit is None or best.limit.kept):
        low, high = best.improvement_interval_95
        kind = "better" if low > 0 else "worse" if high < 0 else "no"
    planned = None if best is None else s.problem.config(best.values)
    return write_page(
        directory / REPORT_FILE,
        "campaign.html.j2",
        title=f"{s.name} · gatetune campaign",
        name=f"Campaign {s.name}",
        subtitle=_subtitle(s),
        measure=measure_text(label.full, s.fidelity, s.rocks, [c.name for c in s.conditions]),
        verdict_kind=kind,
        advised=advised,
        changed=None if best is None or best.keep_default else changed_table(best),
        plan=embed(plan_figure(planned)) if isinstance(planned, MissionConfig) else "",
        sure=["There is nothing to compare."] if best is None else worth_sentences(best, s),
        gate=[] if best is None else gate_sentences(best, campaign),
        earned=[] if best is None else earned_sentences(results, best),
        result_tables=list(map(results_table, results)),
        result_legend=legend_of(results[0].table) if results else "",
        measured=[(name, f"{name}/{REPORT_FILE}") for name in measured],
        next_why=why,
        next_command=command,
        walk=f"{SHOWN}/{VIEW_FILE}" if (directory / SHOWN / VIEW_FILE).is_file() else "",
        warnings=_warnings(s, status, best, trials),
        status=status,
        degraded=sum(t.state == "complete" and t.record.status == "degraded" for t in trials),
        computing=duration(status.mission_wall_s),
        best=best,
        settings=s,
        word=word,
        label=label,
        outcomes=_outcome_figures(campaign, best, trials, names),
        slices=[] if best is None else _slices(campaign, best),
        noise=""
        if best is None
        else with_unit(best.noise_sd, label.difference_unit, decimals_for(best.noise_sd)),
        learned=campaign.learned,
        earlier_rocks=[Path(rock).stem for rock in campaign.learned.rocks] if campaign.learned else [],
        sources=["shipped with this program" if source == SHIPPED else source for source in s.sources],
        per_rock=None if best is None else rock_table(best, campaign),
        failures=_failure_table(trials, names, word),
        run=shlex.quote(str(directory)),
        command=reproduce_command(campaign),
        provenance=_provenance(s, trials),
        settings_file=SETTINGS_FILE,
        settings_yaml=to_yaml(s.to_dict(), allow_unicode=True),
        revision=git_revision(),
    )


def write_showcase_page(campaign: Campaign) -> Path | None:
    """Write the page of the missions that `showcase_jobs` has run, unless it is there; None where there is none to show."""
    shown = [job for job in showcase_jobs(campaign) if was_run(job)]
    if not shown:
        return None
    page = campaign.directory / SHOWN / VIEW_FILE
    made_from = [job.directory / RESULT for job in shown]
    if not page.is_file() or any(page.stat().st_mtime < file.stat().st_mtime for file in made_from):
        try:
            write_mission_view([job.directory for job in shown], page, shown[0].rock)
        except UserError:  # a mission that ended before its first photograph has no page
            return None
    return page


# -- the first screen: questions, each with an answer that the state of the campaign decides -------------------


def _instance_names(s: CampaignSettings) -> dict[Instance, str]:
    """``slab``, or ``slab, field`` where there is more than one condition."""
    rocks = dict(zip(s.rocks, short_names(s.rocks)))
    several = len(s.conditions) > 1
    return {
        instance: f"{rocks[instance.rock]}, {instance.condition}" if several else rocks[instance.rock]
        for instance in s.problem.instances
    }


def _subtitle(s: CampaignSettings) -> str:
    """What the campaign was asked for, on what, in which search space."""
    label = metric_label(s.objective.metric)
    said = f"The goal is the highest {label.full}"
    if s.objective.direction == "minimise":
        said = (
            f"The goal is the {'fewest' if s.objective.metric in COUNTS else 'lowest'} {label.full.lower()}"
        )
    if s.second is not None and s.limit is not None:
        _, how = bound(s.second.metric, s.second.direction, s.limit)
        said += f" with {metric_label(s.second.metric).full} {how}"
    conditions = [condition.name for condition in s.conditions]
    under = "" if conditions == [IDEAL] else f"; under {', '.join(conditions)}"
    return (
        f"{said}, on {', '.join(short_names(s.rocks))}{under}. The campaign tunes {s.space.dimension} parameters "
        f"(search space {s.space.name})."
    )


# -- what limits the answer ------------------------------------------------------------------------------------


def _warnings(
    s: CampaignSettings, status: CampaignStatus, best: Recommendation | None, trials: Sequence[Trial]
) -> list[str]:
    out = [_stop_reason(status, trials)] if status.remaining else []
    if best is not None and (at_bounds := bounds_text(best, s)):
        out.append(at_bounds)
    degraded = sum(t.record.status == "degraded" for t in trials)
    for count, what in ((degraded, "were degraded"), (status.failed, "failed")):
        if count > 0.2 * status.finished:
            out.append(f"{count} of {status.finished} finished missions {what}; see below.")
    return out


def _stop_reason(status: CampaignStatus, trials: Sequence[Trial]) -> str:
    """Why the budget was not used up."""
    if status.exhausted:
        return f"The search has ended: {status.exhausted}."
    begin = "Not finished"
    last = [t for t in trials if t.state != "running" and t.reason != REFUSED][-MAX_CONSECUTIVE_FAILURES:]
    if len(last) == MAX_CONSECUTIVE_FAILURES and all(t.state == "failed" for t in last):
        begin = (
            f"Stopped after {MAX_CONSECUTIVE_FAILURES} failures in a row, the last with {last[-1].reason!r}"
        )
    running = f", {status.running} in flight or interrupted" if status.running else ""
    return f"{begin}: {status.finished} of {status.budget} missions are finished{running}."


def bounds_text(best: Recommendation, s: CampaignSettings) -> str:
    """Which recommended values lie at a bound of the search space beyond which a mission could run; empty where none does.

    The values of a plain plan are given and not searched for.
    """
    if best.plain:
        return ""
    names = [
        parameter_label(p.path).name
        for p in s.space.parameters
        if p.path in best.changed and p.kind != "categorical" and _ends_too_early(s, p, best.values)
    ]
    if not names:
        return ""
    return f"{', '.join(names)}: the recommended value lies at a bound of the search space. A wider one may have better values."


def _ends_too_early(s: CampaignSettings, p: Parameter, values: Mapping[str, Any]) -> bool:
    at = p.to_unit(values[p.path])
    if NEAR_A_BOUND < at < 1.0 - NEAR_A_BOUND:
        return False
    span = (p.high - p.low) * (1 if at > 0.5 else -1)
    beyond = [
        values[p.path] + (share * span if p.kind == "float" else math.copysign(1, span)) for share in BEYOND
    ]
    return any(s.problem.can_run({**values, p.path: value}) for value in beyond)


# -- missions and model ----------------------------------------------------------------------------------------


def _failure_table(trials: Sequence[Trial], names: Mapping[Instance, str], word: str) -> Table:
    """Failed and degraded missions by reason, the commonest first: how many, on which rocks, the last one's message."""
    groups: dict[tuple[str, str], list[Trial]] = collections.defaultdict(list)
    for t in trials:
        if t.state == "failed" or t.record.status == "degraded":
            groups[t.reason or "unknown", "failed" if t.state == "failed" else "degraded"].append(t)
    rows = [
        [
            reason,
            outcome,
            str(len(group)),
            "; ".join(sorted({names[t.instance] for t in group})),
            group[-1].record.message,
        ]
        for (reason, outcome), group in sorted(groups.items(), key=lambda item: -len(item[1]))
    ]
    columns = ("reason", "outcome", "missions", f"{word}s", "last message")
    return Table.of("", columns, rows)


def _outcome_figures(
    campaign: Campaign,
    best: Recommendation | None,
    trials: Sequence[Trial],
    names: Mapping[Instance, str],
) -> list[str]:
    """Outcomes over the trials with the best so far and, where photographs are the objective, over their number."""
    s, quality = campaign.settings, campaign.settings.goal.shown
    shown = [t for t in trials if t.state != "running"]
    marks = [(s.problem.default, "default"), *([] if best is None else [(best.values, "recommended")])]

    def figure(x: str, place: Callable[[Trial], float | None], sign: float) -> str:
        points: dict[str, list[tuple[float, float | None, str]]] = {}
        for t in shown:
            if (at := place(t)) is not None:
                value = t.raw if quality == s.objective else t.measured(quality)
                mark = next((mark for values, mark in reversed(marks) if t.values == values), "")
                points.setdefault(names[t.instance], []).append((at, value, mark))
        return draw_outcomes(points, metric_label(quality.metric), x, sign)

    figures = [figure("trial", lambda t: t.number, quality.sign)]
    if s.objective.metric in COUNTS and quality != s.objective:
        figures.append(figure("photographs", lambda t: t.raw, 0.0))
    return figures


def _slices(campaign: Campaign, best: Recommendation) -> list[str]:
    """What the surrogate predicts along each parameter."""
    s, goal = campaign.settings, campaign.settings.goal
    model = campaign.surrogate_from([o for o in campaign.history() if o.feasible])
    label = metric_label(goal.shown.metric)
    return draw_slices(model, s.space.parameters, best.values, label, goal.shown.sign)


# -- where it is from ------------------------------------------------------------------------------------------


def _provenance(s: CampaignSettings, trials: Sequence[Trial]) -> list[tuple[str, str]]:
    """When, by what and on which rocks; the settings stand below it."""
    rocks, word = dict(zip(s.rocks, short_names(s.rocks))), s.problem.instance_word
    hashes = {rocks[t.rock]: t.record.rock_sha256[:12] for t in trials if t.record.rock_sha256}
    times = (
        [t.record.started for t in trials if t.record.started],
        [t.record.finished for t in trials if t.record.finished],
    )
    between = f"{min(times[0]):%Y-%m-%d %H:%M} and {max(times[1]):%Y-%m-%d %H:%M}" if all(times) else "–"
    named = ", ".join(f"{name} {digest}…" for name, digest in sorted(hashes.items()))
    return [
        ("run between", between),
        *recorded_rows(recorded([t.record.directory for t in trials])),
        ("base configuration", s.problem.base.digest()),
        (f"{word}s (SHA-256)", named or "not recorded"),
    ]


def reproduce_command(campaign: Campaign) -> str:
    """The command line that runs the same campaign again, in a directory beside it."""
    beside = campaign.directory.with_name(f"{campaign.directory.name}-again")
    file = str(campaign.directory / SETTINGS_FILE)
    options = campaign.settings.problem.options()
    return shlex.join(["gatetune", "campaign", "run", file, "--out", str(beside), *options])
