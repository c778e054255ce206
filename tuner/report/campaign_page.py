"""``report.html`` of a campaign: one self-contained page, with the evidence."""

from __future__ import annotations

import collections
import math
import shlex
from collections.abc import Callable, Mapping
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from nbv.config import IDEAL, MissionConfig
from nbv.errors import UserError
from nbv.mission.run_directory import RESULT
from nbv.provenance import git_revision
from nbv.safe_files import to_yaml
from tuner.campaign.campaign import Campaign
from tuner.campaign.session import MAX_CONSECUTIVE_FAILURES, REFUSED
from tuner.campaign.settings import CampaignSettings
from tuner.campaign.settings_file import SETTINGS_FILE
from tuner.campaign.shipped import SHIPPED
from tuner.campaign.showcase import SHOWN, showcase_jobs, was_run
from tuner.comparison.advice import Advice, advice_of, next_step
from tuner.comparison.result import all_results
from tuner.missions.job import Trial
from tuner.missions.registry import mission_kind
from tuner.problem.baselines import label as strategy_label
from tuner.problem.deterministic_metrics import PHOTOGRAPHS
from tuner.problem.instances import Instance
from tuner.problem.objective import COUNTS
from tuner.problem.observations import configuration_key
from tuner.problem.search_space import Parameter
from tuner.recommendation.recommendation import Recommendation
from tuner.report.answer import (
    advice_lines,
    bound,
    gate_words,
    may_fail_on_most,
    next_text,
    runner_up_sentence,
    switch_sentences,
    traces_of,
    value_text,
    worth_sentences,
)
from tuner.report.comparison import REPORT_FILE, earned_sentences, legend_of, results_table
from tuner.report.figures import draw_outcomes, draw_slices, plan_figure
from tuner.report.labels import (
    counted,
    decimals_for,
    duration,
    format_number,
    measure_text,
    metric_label,
    parameter_label,
    with_unit,
)
from tuner.report.mission_view import write_mission_view
from tuner.report.pages import recorded, recorded_rows, write_page
from tuner.report.style import embed, short_names
from tuner.report.table import Table
from tuner.surrogate.model import InstanceMeanGP

VIEW_FILE = "view.html"
POOR_COVERAGE = 0.85  # of 95 % intervals, below which the page says that they are too narrow
MIN_MISSIONS_FOR_COVERAGE = 12
NEAR_A_BOUND = 0.01  # of the range
BEYOND = (0.1, 0.02)  # of the range: how far beyond a bound a mission is tried
OPTIMISM_NOTE = "The recommendation was selected on these trials, so its intervals are optimistic."


class CampaignFacts:
    """What the page is made from, computed when it is first asked for.

    ``recommendation`` is None while there is none (`Campaign.nothing_yet`), ``model`` while no mission has succeeded.
    """

    def __init__(self, campaign: Campaign) -> None:
        self.campaign = campaign
        self.settings: CampaignSettings = campaign.settings
        self.trials: list[Trial] = campaign.trials()
        self.status = campaign.status()
        self.goal = campaign.goal()
        self.modelled = self.goal.modelled  # of the model and its checks
        self.label = metric_label(self.modelled.metric)
        self.default: dict[str, Any] = self.settings.problem.default
        self.rock_names: dict[str, str] = dict(zip(self.settings.rocks, short_names(self.settings.rocks)))
        self.several_conditions = len(self.settings.conditions) > 1
        self.word = self.settings.problem.instance_word

    @cached_property
    def recommendation(self) -> Recommendation | None:
        """The recommendation after all finished missions, the same as in status, export and evaluation."""
        return self.campaign.recommendation(save=False)

    @cached_property
    def advice(self) -> Advice | None:
        """What to fly, from all results."""
        best = self.recommendation
        return None if best is None else advice_of(self.campaign, best)

    @cached_property
    def advised(self) -> list[str]:
        """The same in sentences."""
        best, advice = self.recommendation, self.advice
        return [] if best is None or advice is None else advice_lines(advice, best, self.settings)

    @cached_property
    def model(self) -> InstanceMeanGP | None:
        """The surrogate behind the recommendation; None also where every metric that was asked for is deterministic."""
        feasible = [o for o in self.campaign.history(self.trials) if o.feasible]
        if not feasible or (self.settings.second is None and self.goal.exact.first is not None):
            return None
        return self.campaign.surrogate_from(feasible)

    @property
    def digits(self) -> int:
        """Decimals of the modelled metric, by its uncertainty."""
        best = self.recommendation
        if best is None:
            return 2
        return decimals_for(
            best.limit.sd if best.exact and best.limit is not None else best.sd or best.noise_sd
        )

    def planned_config(self) -> MissionConfig | None:
        """The recommended configuration; None without one, and where it is a mission file's."""
        best = self.recommendation
        config = None if best is None else self.settings.problem.config(best.values)
        return config if isinstance(config, MissionConfig) else None

    def modelled_value(self, trial: Trial) -> float | None:
        """A mission's value of the modelled metric."""
        return trial.raw if self.modelled == self.settings.objective else trial.measured(self.modelled)

    def evaluated(self, values: Mapping[str, Any]) -> list[Trial]:
        """The successful missions of exactly these values."""
        space = self.settings.space
        key = configuration_key(space, values)
        return [t for t in self.trials if t.state == "complete" and configuration_key(space, t.values) == key]

    def instance_name(self, instance: Instance) -> str:
        """``slab``, or ``slab, field`` where there is more than one condition."""
        rock = self.rock_names.get(instance.rock, instance.rock)
        return f"{rock}, {instance.condition}" if self.several_conditions else rock


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
    s, best, directory = facts.settings, facts.recommendation, campaign.directory
    measured = sorted(
        page.parent.name
        for what in ("evaluation*", "confirmation*")
        for page in directory.glob(f"{what}/{REPORT_FILE}")
    )
    why, command = next_text(next_step(campaign, best, facts.advice), campaign, facts.advice)
    found = all_results(campaign, best)
    kind = ""
    if best is not None and not best.keep_default and (best.limit is None or best.limit.kept):
        low, high = best.improvement_interval_95
        kind = "better" if low > 0 else "worse" if high < 0 else "no"
        if best.limit is not None and may_fail_on_most(best.limit):
            kind = "no"
    return write_page(
        directory / REPORT_FILE,
        "campaign.html.j2",
        title=f"{s.name} · gatetune campaign",
        name=f"Campaign {s.name}",
        subtitle=_subtitle(facts),
        measure=measure_text(facts.label.full, s.fidelity, s.rocks, [c.name for c in s.conditions]),
        verdict_kind=kind,
        use=f"Nothing yet: {campaign.nothing_yet()}." if best is None else facts.advised[0],
        advice=facts.advised[1:],
        changed=None if best is None or best.keep_default else _changed_table(best),
        runner_up="" if best is None else runner_up_sentence(best, s),
        plan="" if (planned := facts.planned_config()) is None else embed(plan_figure(planned)),
        sure=sure_answer(facts),
        gate=_gate_answer(facts),
        earned=[] if best is None else earned_sentences(found, best),
        result_tables=list(map(results_table, found)),
        result_legend=legend_of(found[0].table) if found else "",
        measured=[(name, f"{name}/{REPORT_FILE}") for name in measured],
        next_why=why,
        next_command=command,
        walk=f"{SHOWN}/{VIEW_FILE}" if (directory / SHOWN / VIEW_FILE).is_file() else "",
        warnings=_warnings(facts),
        degraded=sum(t.state == "complete" and t.record.status == "degraded" for t in facts.trials),
        computing=duration(facts.status.mission_wall_s),
        facts=facts,
        best=best,
        outcomes=_outcome_figures(facts),
        slices=[]
        if best is None or facts.model is None
        else draw_slices(facts.model, s.space.parameters, best.values, facts.label, facts.modelled.sign),
        noise="" if best is None else with_unit(best.noise_sd, facts.label.difference_unit, facts.digits),
        earlier_rocks=[Path(rock).stem for rock in campaign.learned.rocks] if campaign.learned else [],
        sources=["shipped with this program" if source == SHIPPED else source for source in s.sources],
        per_rock=None if best is None else _rock_table(facts, best),
        failures=_failure_table(facts),
        run=shlex.quote(str(directory)),
        command=reproduce_command(campaign),
        provenance=_provenance(facts),
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


def _subtitle(facts: CampaignFacts) -> str:
    """What the campaign was asked for, on what, in which search space."""
    s, label = facts.settings, metric_label(facts.settings.objective.metric)
    said = f"The goal is the highest {label.full}"
    if s.objective.direction == "minimise":
        said = (
            f"The goal is the {'fewest' if s.objective.metric in COUNTS else 'lowest'} {label.full.lower()}"
        )
    if s.second is not None and s.limit is not None:
        what, how = bound(s.second.metric, s.second.direction, s.limit)
        said += f" with {what if s.second.is_share else metric_label(s.second.metric).full} {how}"
    conditions = [condition.name for condition in s.conditions]
    under = "" if conditions == [IDEAL] else f"; under {', '.join(conditions)}"
    return (
        f"{said}, on {', '.join(facts.rock_names.values())}{under}. The campaign tunes {s.space.dimension} parameters "
        f"(search space {s.space.name})."
    )


def _changed_table(best: Recommendation) -> Table:
    """The parameters that differ from the default."""
    both = best.values, best.default_values
    rows = [(parameter_label(p).name, p, *(value_text(values, p) for values in both)) for p in best.changed]
    return Table.of("", ("changed", "parameter", "use", "default"), rows)


def sure_answer(facts: CampaignFacts) -> list[str]:
    """The recommendation's outcome and gain, as the model predicts them."""
    best = facts.recommendation
    if best is None:
        return ["There is nothing to compare."]
    said, word = worth_sentences(best, facts.settings), facts.word
    if best.keep_default:
        rocks = len({t.rock for t in facts.evaluated(best.values)})
        return [*said, f"It was evaluated on {rocks} of {len(facts.settings.rocks)} {word}s."]
    return [*said, OPTIMISM_NOTE]


def _gate_answer(facts: CampaignFacts) -> str:
    """What the recommended configuration's gate chose, from its missions' traces."""
    best, config = facts.recommendation, facts.planned_config()
    if best is None or config is None:
        return ""
    if config.adaptive_budget == 0:
        return "The recommended plan has no planned view, so no gate is used."
    traces = [trace for _, trace in traces_of(facts.evaluated(best.values))]
    if not traces:
        return "The missions have not recorded their choices."
    records = [record for trace in traces for record in trace]
    said = gate_words(records, strategy_label(config.gate.kind), len(traces))
    return " ".join([*switch_sentences(facts.campaign, facts.trials), said])


# -- what limits the answer ------------------------------------------------------------------------------------


def _warnings(facts: CampaignFacts) -> list[str]:
    best, s, status = facts.recommendation, facts.settings, facts.status
    out = []
    kind = mission_kind(s.fidelity)
    if kind.predicts:
        out.append(f"{kind.note} They rank configurations and do not measure them.")
    if status.remaining:
        out.append(_stop_reason(facts))
    if best is not None and best.observations < MIN_MISSIONS_FOR_COVERAGE:
        out.append(
            f"The model has only {counted(best.observations, 'successful mission')}, so its priors dominate and its intervals "
            "cannot be checked yet."
        )
    elif best is not None and (coverage := best.leave_one_out["coverage_95"]) < POOR_COVERAGE:
        out.append(
            f"The model’s 95 % intervals contained only {100 * coverage:.0f} % of the left-out missions: all intervals on "
            "this page are too narrow."
        )
    if at_bounds := bounds_text(facts):
        out.append(at_bounds)
    degraded = sum(t.record.status == "degraded" for t in facts.trials)
    for count, what in ((degraded, "were degraded"), (status.failed, "failed")):
        if count > 0.2 * status.finished:
            out.append(f"{count} of {status.finished} finished missions {what}; see below.")
    return out


def _stop_reason(facts: CampaignFacts) -> str:
    """Why the budget was not used up."""
    status, begin = facts.status, "Not finished"
    last = [t for t in facts.trials if t.state != "running" and t.reason != REFUSED][
        -MAX_CONSECUTIVE_FAILURES:
    ]
    if len(last) == MAX_CONSECUTIVE_FAILURES and all(t.state == "failed" for t in last):
        begin = (
            f"Stopped after {MAX_CONSECUTIVE_FAILURES} failures in a row, the last with {last[-1].reason!r}"
        )
    running = f", {status.running} in flight or interrupted" if status.running else ""
    return f"{begin}: {status.finished} of {status.budget} missions are finished{running}."


def bounds_text(facts: CampaignFacts) -> str:
    """Which recommended values lie at a bound of the search space beyond which a mission could run; empty where none does.

    The values of a plain plan are given and not searched for.
    """
    best, s = facts.recommendation, facts.settings
    if best is None or best.plain:
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


def _rock_table(facts: CampaignFacts, best: Recommendation) -> Table:
    """Instance by instance: missions, failures, what the recommendation and the default had there, with their missions."""

    def measured(mean: float | None, missions: int) -> str:
        return f"{format_number(mean, facts.digits)} ({missions})" if missions else format_number(None)

    rows = []
    for row in best.per_rock:
        own = [t for t in facts.trials if t.state != "running" and t.instance == row.instance]
        outcomes = [facts.modelled_value(t) for t in own if t.values == best.default_values]
        default = [value for value in outcomes if value is not None]
        rows.append(
            [
                facts.instance_name(row.instance),
                str(len(own)),
                str(sum(t.raw is None for t in own)),
                format_number(facts.label.possible(row.predicted), facts.digits),
                measured(row.observed, row.missions),
                measured(float(np.mean(default)) if default else None, len(default)),
            ]
        )
    unit = f" in {facts.label.unit}" if facts.label.unit else ""
    caption = (
        f"{facts.label.full} of the recommended configuration{unit}. Predicted is the posterior mean there; measured is the "
        "mean of the missions that ran there, with their number."
    )
    columns = (facts.word, "missions there", "failed", "predicted", "measured", "default measured")
    return Table.of("", columns, rows, caption)


def _failure_table(facts: CampaignFacts) -> Table:
    """Failed and degraded missions by reason, the commonest first: how many, on which rocks, the last one's message."""
    groups: dict[tuple[str, str], list[Trial]] = collections.defaultdict(list)
    for t in facts.trials:
        if t.state == "failed" or t.record.status == "degraded":
            groups[t.reason or "unknown", "failed" if t.state == "failed" else "degraded"].append(t)
    rows = [
        [
            reason,
            outcome,
            str(len(group)),
            "; ".join(sorted({facts.instance_name(t.instance) for t in group})),
            group[-1].record.message,
        ]
        for (reason, outcome), group in sorted(groups.items(), key=lambda item: -len(item[1]))
    ]
    columns = ("reason", "outcome", "missions", f"{facts.word}s", "last message")
    return Table.of("", columns, rows)


def _outcome_figures(facts: CampaignFacts) -> list[str]:
    """Outcomes over the trials with the best so far and, where photographs are the objective, over their number."""
    best, s = facts.recommendation, facts.settings
    shown = [t for t in facts.trials if t.state != "running"]

    def kind(t: Trial) -> str:
        return (
            "recommended"
            if best is not None and t.values == best.values
            else "default" * (t.values == facts.default)
        )

    def figure(x: str, place: Callable[[Trial], float | None], sign: float) -> str:
        points = {
            facts.instance_name(i): [
                (at, facts.modelled_value(t), kind(t))
                for t in shown
                if t.instance == i and (at := place(t)) is not None
            ]
            for i in dict.fromkeys(t.instance for t in shown)
        }
        return draw_outcomes(points, facts.label, x, sign)

    figures = [figure("trial", lambda t: t.number, facts.modelled.sign)]
    if s.objective.metric == PHOTOGRAPHS and facts.modelled != s.objective:
        figures.append(figure("photographs", lambda t: t.raw, 0.0))
    return figures


# -- where it is from ------------------------------------------------------------------------------------------


def _provenance(facts: CampaignFacts) -> list[tuple[str, str]]:
    """When, by what, with which settings, on which rocks."""
    s = facts.settings
    hashes = {
        facts.rock_names.get(t.rock, t.rock): t.record.rock_sha256[:12]
        for t in facts.trials
        if t.record.rock_sha256
    }
    times = (
        [t.record.started for t in facts.trials if t.record.started],
        [t.record.finished for t in facts.trials if t.record.finished],
    )
    between = f"{min(times[0]):%Y-%m-%d %H:%M} and {max(times[1]):%Y-%m-%d %H:%M}" if all(times) else "–"
    named = ", ".join(f"{name} {digest}…" for name, digest in sorted(hashes.items()))
    return [
        ("run between", between),
        *recorded_rows(recorded([t.record.directory for t in facts.trials])),
        s.problem.provenance(),
        ("conditions", ", ".join(condition.name for condition in s.conditions)),
        ("base configuration", s.problem.base.digest()),
        ("sampler and seed", f"{s.sampler}, {s.seed}"),
        (
            "ledger",
            "an Optuna study with one trial per mission: its study.best_trial is the best single mission"
            f"{' that met the constraint' if s.limit is not None else ''}, on one {facts.word}, not the recommendation",
        ),
        (f"{facts.word}s (SHA-256)", named or "not recorded"),
    ]


def reproduce_command(campaign: Campaign) -> str:
    """The command line that runs the same campaign again, in a directory beside it."""
    beside = campaign.directory.with_name(f"{campaign.directory.name}-again")
    file = str(campaign.directory / SETTINGS_FILE)
    options = campaign.settings.problem.options()
    return shlex.join(["gatetune", "campaign", "run", file, "--out", str(beside), *options])
