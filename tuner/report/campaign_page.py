"""``report.html`` of a campaign: one self-contained page, with the evidence."""

from __future__ import annotations

import collections
import math
import shlex
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from nbv.config import IDEAL
from nbv.errors import UserError
from nbv.mission.run_directory import RESULT
from nbv.provenance import git_revision
from nbv.safe_files import to_yaml
from tuner.answer import effects
from tuner.answer.answer import Answer, answer_of
from tuner.answer.evidence import Evidence, evidence_of
from tuner.campaign.campaign import Campaign, CampaignStatus
from tuner.campaign.session import MAX_CONSECUTIVE_FAILURES, REFUSED, SHOWN, showcase_jobs, was_run
from tuner.campaign.settings import CampaignSettings
from tuner.campaign.settings_file import SETTINGS_FILE
from tuner.missions.job import Trial
from tuner.problem.baselines import label
from tuner.problem.goal import COUNTS
from tuner.problem.instances import Instance
from tuner.problem.search_space import PHOTOGRAPHS, Parameter, Region
from tuner.recommendation.recommendation import Recommendation
from tuner.report import words
from tuner.report.figures import (
    draw_best_so_far,
    draw_contour,
    draw_outcomes,
    draw_slices,
    embed,
    plan_figure,
)
from tuner.report.labels import (
    Table,
    decimals_for,
    difference_text,
    duration,
    format_number,
    measure_text,
    metric_label,
    number_text,
    parameter_label,
    short_names,
    with_unit,
)
from tuner.report.mission_view import write_mission_view
from tuner.report.pages import recorded, recorded_rows, write_page
from tuner.surrogate.model import InstanceMeanGP

REPORT_FILE, VIEW_FILE = "report.html", "view.html"
NEAR_A_BOUND = 0.01  # of the range
BEYOND = (0.1, 0.02)  # of the range: how far beyond a bound a mission is tried
POOR_COVERAGE, MIN_FOR_COVERAGE = 0.85, 12  # of 95 % intervals, and missions from which on it is judged


def write_campaign_report(campaign: Campaign, answer: Answer | None = None) -> Path:
    """Write ``report.html`` into the campaign's run directory; the path of the page.

    The campaign may be finished, interrupted or still running. ``answer``: where it is known already.

    Raises
    ------
    UserError
        The campaign has no finished mission, or the directory cannot be written.
    """
    s, status, trials, directory = campaign.settings, campaign.status(), campaign.trials(), campaign.directory
    if status.finished == 0:
        raise UserError(f"{directory} has no finished mission; run or resume the campaign first")
    answer = answer or answer_of(campaign)
    found, metric = answer.recommended, metric_label(s.objective.metric)
    rocks, evidence = dict(zip(s.rocks, short_names(s.rocks))), evidence_of(campaign, answer.recommended)
    # ``slab``, or ``slab, field`` where there is more than one condition.
    several = len(s.conditions) > 1
    names = {i: f"{rocks[i.rock]}, {i.condition}" if several else rocks[i.rock] for i in s.problem.instances}
    fly = "" if answer.fly is None else answer.fly.strategy
    model = campaign.surrogate() if found else None
    main = found[list(found)[-1]] if found else None
    return write_page(
        directory / REPORT_FILE,
        "campaign.html.j2",
        title=f"{s.name} · gatetune campaign",
        name=f"Campaign {s.name}",
        subtitle=_subtitle(s),
        measure=measure_text(metric.full, s.fidelity, s.rocks, [c.name for c in s.conditions]),
        advised=words.sentences(answer),
        plan=embed(plan_figure(answer.configs[fly])) if fly else "",
        next=answer.next,
        result_tables=[words.table_lines(table, answer.metric, fly) for table in answer.tables],
        by_target=words.by_target(evidence, answer.metric) if found else None,
        legend=words.legend(answer.tables) if answer.tables else "",
        tuned=[]
        if model is None
        else [
            _tuned(campaign, answer, names, values, model, evidence)
            for names, values in words.alike({name: each.values for name, each in found.items()})
        ],
        walk=f"{SHOWN}/{VIEW_FILE}" if (directory / SHOWN / VIEW_FILE).is_file() else "",
        warnings=_warnings(campaign, status, answer),
        chosen=words.chosen_text(answer.chosen_by),
        status=status,
        degraded=sum(t.state == "complete" and t.record.status == "degraded" for t in trials),
        computing=duration(status.mission_wall_s),
        settings=s,
        label=metric,
        outcomes=_outcome_figures(campaign, main, trials, names),
        model=None
        if main is None
        else {
            "missions": main.observations,
            "noise": with_unit(main.noise_sd, metric.difference_unit, decimals_for(main.noise_sd)),
            "coverage": 100 * main.leave_one_out["coverage_95"],
        },
        learned=campaign.learned,
        earlier_rocks=[Path(rock).stem for rock in campaign.learned.rocks] if campaign.learned else [],
        sources=s.learn_from,
        failures=_failure_table(trials, names),
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


# -- what was tuned --------------------------------------------------------------------------------------------


def _tuned(
    campaign: Campaign,
    answer: Answer,
    names: str,
    values: Mapping[str, Any],
    model: InstanceMeanGP,
    evidence: Evidence,
) -> dict[str, Any]:
    """One tuned configuration: its values and what they earned, by the model and by missions, with figures.

    ``names``: of the answers that have these ``values``; they are shown as those of the largest region.
    """
    s, sign = campaign.settings, campaign.settings.objective.sign
    best = [each for each in answer.recommended.values() if each.values == values][-1]
    region = next(region for region in s.problem.answers if region.name == best.name)
    metric = metric_label(s.objective.metric)
    unit = metric.difference_unit
    rows = effects.parameter_rows(model, region, best.values, best.default_values)
    groups = effects.earned_by_group(model, s.space, best.values, best.default_values)
    so_far = [(number, sign * y) for number, y in effects.best_so_far(model, region, campaign.history())]
    gate = answer.gates[best.name]
    has_thresholds = all(path in s.space.paths for path in effects.GATE_THRESHOLDS)
    contour = ""
    if has_thresholds:
        contour = draw_contour(
            *effects.gate_contour(model, s.space, best.values), best.values, gate.d95_m, metric, sign
        )
    return {
        "name": names,
        "missions": best.missions,
        "same": best.keep_default,
        "parameters": words.parameters_table(best.name, rows, metric),
        "gate": words.gate_sentence(names, gate) if s.problem.config(best.values).planned_views else "",
        "split": _split_table(groups, best.name, evidence, unit),
        "best": _configurations(model, region, campaign, sign),
        "contour": contour,
        "so_far": draw_best_so_far(so_far, metric) if len(so_far) > 1 else "",
        "slices": draw_slices(
            model, [p for p in s.space.parameters if p.path not in region.held], best.values, metric, sign
        ),
    }


def _split_table(
    groups: Mapping[str, effects.Effect], name: str, evidence: Evidence, unit: str
) -> Table | None:
    """What is lost where one group of parameters goes back to the paper's values: by the model, and by paired missions."""
    if not groups:
        return None
    rows = []
    for group, effect in groups.items():
        measured = [
            difference_text(part.gain(name, f"{name}-without-{group}"))
            for part in (evidence.on(held_out=True), evidence.on(held_out=False))
        ]
        rows.append([group, words.effect_text(effect), *measured])
    caption = (
        f"In {unit or 'the metric’s unit'}: the tuned configuration minus the same with that group as in the paper. The first column is the "
        "surrogate's, the others are paired missions of gatetune evaluate; a dash was not run."
    )
    return Table.of("", ("group", "by the model", "held-out targets", "training targets"), rows, caption)


def _configurations(model: InstanceMeanGP, region: Region, campaign: Campaign, sign: float) -> Table:
    """The ten best configurations of a region."""
    s = campaign.settings
    number = s.space.base.get(PHOTOGRAPHS)
    rows = []
    for each in effects.best_configurations(model, region, campaign.history(), number, sign):
        changed = [p for p, v in each.values.items() if v != s.problem.default[p] and p not in region.held]
        named = ", ".join(
            f"{p.replace('.weights.', '.')} {words.value_text(p, each.values[p])}" for p in changed[:5]
        )
        more = f" and {len(changed) - 5} more" if len(changed) > 5 else ""
        interval = f"{format_number(each.mean)} [{format_number(each.low)}, {format_number(each.high)}]"
        rows.append(
            [
                f"{named}{more}" or "as in the paper",
                interval,
                str(each.missions),
                "–" if each.planned is None else str(each.planned),
            ]
        )
    return Table.of("", ("changes", "posterior mean [95 %]", "missions", "planned views"), rows)


# -- what limits the answer ------------------------------------------------------------------------------------


def _warnings(campaign: Campaign, status: CampaignStatus, answer: Answer) -> list[str]:
    s, trials = campaign.settings, campaign.trials()
    out = [_stop_reason(status, trials)] if status.remaining else []
    out += [text for each in answer.recommended.values() if (text := bounds_text(each, s))]
    for best in list(answer.recommended.values())[-1:]:
        for o in best.outliers[:3]:
            how = "which all others contradict, so it is left out"
            if o.counts_as is not None:
                how = f"far from all others; it counts as {number_text(o.counts_as)}"
            out.append(f"Mission #{o.mission:04d} measured {number_text(o.measured)}, {how}.")
        coverage = best.leave_one_out["coverage_95"]
        if best.observations >= MIN_FOR_COVERAGE and coverage < POOR_COVERAGE:
            out.append(
                f"The model's 95 % intervals contain only {100 * coverage:.0f} % of the left-out missions: all its intervals are too narrow."
            )
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
    """Which tuned values lie at a bound of the search space beyond which a mission could run; empty where none does."""
    names = [
        parameter_label(p.path).name
        for p in s.space.parameters
        if p.path in best.changed and p.kind != "categorical" and _ends_too_early(s, p, best.values)
    ]
    if not names:
        return ""
    return f"{label(best.name)}: {', '.join(names)} lies at a bound of the search space. A wider one may have better values."


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


def _subtitle(s: CampaignSettings) -> str:
    """What the campaign was asked for, on what, in which search space."""
    about = metric_label(s.objective.metric)
    lines = f"The goal is the highest {about.full}"
    if s.objective.direction == "minimise":
        fewest = "fewest" if s.objective.metric in COUNTS else "lowest"
        lines = f"The goal is the {fewest} {about.full.lower()}"
    if s.second is not None and s.limit is not None:
        lines += f" with {words.limit_text(s.second.metric, s.second.direction, s.limit)}"
    conditions = [condition.name for condition in s.conditions]
    under = "" if conditions == [IDEAL] else f"; under {', '.join(conditions)}"
    return (
        f"{lines}, on {', '.join(short_names(s.rocks))}{under}. The campaign tunes {s.space.dimension} parameters "
        f"(search space {s.space.name})."
    )


def _failure_table(trials: Sequence[Trial], names: Mapping[Instance, str]) -> Table:
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
    return Table.of("", ("reason", "outcome", "missions", "targets", "last message"), rows)


def _outcome_figures(
    campaign: Campaign, best: Recommendation | None, trials: Sequence[Trial], names: Mapping[Instance, str]
) -> list[str]:
    """Outcomes over the trials with the best so far and, where photographs are the objective, over their number."""
    s = campaign.settings
    shown, quality = [t for t in trials if t.state != "running"], s.goal.shown
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


# -- where it is from ------------------------------------------------------------------------------------------


def _provenance(s: CampaignSettings, trials: Sequence[Trial]) -> list[tuple[str, str]]:
    """When, by what and on which rocks; the settings stand below it."""
    rocks = dict(zip(s.rocks, short_names(s.rocks)))
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
        ("targets (SHA-256)", named or "not recorded"),
        ("ledger", f"an Optuna study: optuna-dashboard {shlex.quote('study.journal')}"),
    ]


def reproduce_command(campaign: Campaign) -> str:
    """The command line that runs the same campaign again, in a directory beside it."""
    beside = campaign.directory.with_name(f"{campaign.directory.name}-again")
    return shlex.join(
        ["gatetune", "campaign", "run", str(campaign.directory / SETTINGS_FILE), "--out", str(beside)]
    )
