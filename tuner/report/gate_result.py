"""What tuning the gate earned: one table beside the paper's strategies and the controls, and sentences, for terminal, page and JSON."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from rich.table import Table

from nbv.errors import UserError
from tuner.campaign.campaign import Campaign
from tuner.evaluation.baselines import (
    KINDS,
    TUNED,
    TUNED_POOL_HYB_H,
    kind_of,
    label,
    sees_ground_truth,
)
from tuner.evaluation.comparison import (
    MetricRow,
    PairedDifference,
    strategy_difference,
    strategy_interval,
)
from tuner.evaluation.earned import GroupGain, believed_gains, measured_steps, same_photographs
from tuner.evaluation.plan import PLAN_FILE, EvaluationPlan
from tuner.missions.job import Trial
from tuner.problem.groups import B_AWARE, CHOICE, COVIS, THRESHOLDS, grouped
from tuner.recommendation.recommendation import Recommendation
from tuner.report.labels import MISSING, counted, format_number, metric_label
from tuner.report.style import short_names

HELD_OUT, TRAINING = "evaluation", "confirmation"  # where a campaign's comparisons lie
_ROWS = {
    "photos": MetricRow("", "Photographs", "costs.images", "", False, 0),
    "flight": MetricRow("", "Flight", "costs.flight_time_s", "s", False, 0),
    "F 48": MetricRow("", "F-score, 48 mm", "observable.f_score_48mm", "%", True),
    "F 80": MetricRow("", "F-score, 80 mm", "observable.f_score_80mm", "%", True),
    "C 48": MetricRow("", "Completeness, 48 mm", "observable.completeness_48mm", "%", True),
    "C 80": MetricRow("", "Completeness, 80 mm", "observable.completeness_80mm", "%", True),
    "C2C": MetricRow("", "Mean C2C", "observable.c2c_mean_mm", "mm", False),
}
COLUMNS = ("strategy", *_ROWS, "F 48 from Hyb-H")
LEGEND = (
    "F: F-score, C: completeness (%), at 48 and 80 mm; C2C: mean distance from cloud to surface (mm); flight (s); all on the "
    "observable surface. Last column: F-score at 48 mm, paired difference from Hyb-H with its 95 % interval."
)


@dataclass(frozen=True)
class ResultRow:
    """One strategy on one set of rocks."""

    strategy: str
    label: str
    kind: str  # of `KINDS`
    values: dict[str, float | None]  # by column
    difference: (
        tuple[float, float | None, float | None] | None
    )  # of the F-score at 48 mm from Hyb-H, 95 % interval
    same_as: str = ""  # the label of the strategy whose photographs it took in every mission
    missions: int = 0
    failed: int = 0


@dataclass(frozen=True)
class ResultBlock:
    """All strategies on one set of rocks."""

    rocks: tuple[str, ...]
    held_out: bool
    replicates: int
    rows: list[ResultRow]
    complete: bool
    directory: str

    @property
    def title(self) -> str:
        """``Held-out rocks: arch, fin (3 replicates)``."""
        what = "Held-out rocks" if self.held_out else "Training rocks"
        names = ", ".join(short_names(self.rocks))
        return f"{what}: {names} ({counted(self.replicates, 'replicate')})"


@dataclass(frozen=True)
class GateResult:
    """The table and what it says."""

    blocks: list[ResultBlock]  # held-out rocks first
    sentences: list[str]
    groups: list[GroupGain]  # as the model believes them

    def to_dict(self) -> dict[str, Any]:
        """JSON form; differences and gains in F-score points, positive where better."""
        return dataclasses.asdict(self)


def gate_result(campaign: Campaign) -> GateResult | None:
    """Return the comparison of the present recommendation, from the evaluations in its run directory; None without one."""
    s, best = campaign.settings, campaign.recommendation(save=False)
    if best is None or s.mission is not None:
        return None
    tuned, blocks, sources = (
        s.config(best.values),
        list[ResultBlock](),
        list[tuple[ResultBlock, list[Trial]]](),
    )
    for held_out, name in ((True, HELD_OUT), (False, TRAINING)):
        found = [_block(path.parent, held_out) for path in _plans(campaign, name, tuned)]
        if found:  # the one with the most rocks stands for all
            sources.append(max(found, key=lambda pair: (len(pair[0].rocks), pair[0].replicates)))
            blocks.append(sources[-1][0])
    if not blocks:
        return None
    groups: list[GroupGain] = []
    if best.changed and not best.exact:
        history = [o for o in campaign.history() if o.feasible]
        groups = believed_gains(campaign.surrogate_from(history), best)
    sentences = [line for block, records in sources for line in _sentences(block, records, best)]
    return GateResult(blocks, [*sentences, *_suspects(sources, best)], groups)


def _plans(campaign: Campaign, name: str, tuned: Any) -> list[Any]:
    """Return the plan files of evaluations of the configuration ``tuned``."""
    found = []
    for path in sorted(campaign.directory.glob(f"{name}*/{PLAN_FILE}")):
        try:
            plan = EvaluationPlan.load(path.parent)
        except UserError:  # another program's folder, or a plan that was damaged since
            continue
        if plan.strategies.get(TUNED) == tuned and "hyb-h" in plan.strategies:
            found.append(path)
    return found


def _block(directory: Any, held_out: bool) -> tuple[ResultBlock, list[Trial]]:
    plan = EvaluationPlan.load(directory)
    records, names = plan.records(directory), sorted(plan.strategies, key=lambda n: KINDS.index(kind_of(n)))
    same, metric = same_photographs(records, names), _ROWS["F 48"]
    rows = []
    for name in names:
        own = [r for r in records if r.strategy == name]
        cells = {column: strategy_interval(records, name, row.key) for column, row in _ROWS.items()}
        d = None if name == "hyb-h" else strategy_difference(records, name, "hyb-h", metric)
        rows.append(
            ResultRow(
                name,
                label(name),
                kind_of(name),
                {column: None if cell is None else cell.mean for column, cell in cells.items()},
                None if d is None else (d.interval.mean, d.interval.low, d.interval.high),
                label(same[name]) if name in same else "",
                sum(r.status != "failed" for r in own),
                sum(r.status == "failed" for r in own),
            )
        )
    expected = len(plan.strategies) * len(plan.worlds) * plan.replicates
    block = ResultBlock(plan.rocks, held_out, plan.replicates, rows, len(records) == expected, directory.name)
    return block, records


# -- sentences -----------------------------------------------------------------------------------------------


def _sentences(block: ResultBlock, records: list[Trial], best: Recommendation) -> list[str]:
    where = f"On {counted(len(block.rocks), 'held-out rock' if block.held_out else 'training rock')}"
    rows = {row.strategy: row for row in block.rows}
    tuned, metric = rows[TUNED], _ROWS["F 48"]
    if best.keep_default:
        said = [f"{where}: nothing was found that is better than Hyb-H, so Tuned is Hyb-H."]
    elif tuned.difference is None:
        return [f"{where} Tuned and Hyb-H have no mission in common."]
    else:
        said = [f"{where} Tuned has {_points(*tuned.difference)} over Hyb-H."]
        steps = measured_steps(records, list(rows), "hyb-h", metric, best.changed)
        if len(steps) > 1:
            parts = ", ".join(f"the {step.what} {_interval(step.difference)}" for step in steps)
            said[0] = f"{said[0][:-1]}; of these {parts}."
    rivals = {
        name: row.values["F 48"]
        for name, row in rows.items()
        if name != TUNED
        and row.values["F 48"] is not None
        and not sees_ground_truth(name)
        and row.kind == KINDS[2]
    }
    if rivals:
        name = max(rivals, key=lambda n: rivals[n] or 0.0)
        d = strategy_difference(records, TUNED, name, metric)
        if d is not None:
            gain = _interval(d)
            said.append(f"{where} against the best control, {label(name)}: Tuned {gain}.")
    switched = [label(name) for name, row in rows.items() if name == "hyb-h" and row.same_as]
    if switched:
        said.append(
            f"{where} Hyb-H took the photographs of {rows['hyb-h'].same_as} in every mission: its gate had no effect."
        )
    return said


def _suspects(sources: Sequence[tuple[ResultBlock, list[Trial]]], best: Recommendation) -> list[str]:
    """Return the verdict on the paper's two suspects: the thresholds, and weights that both scorers share."""
    if best.keep_default:
        return []
    block, records = sources[0]
    changed, names = grouped(best.changed), [row.strategy for row in block.rows]
    reset = [name for name in CHOICE if name not in changed]
    begin = "The paper suspects Hyb-H's thresholds and its shared weights."
    if len(reset) == len(CHOICE):
        return [f"{begin} On these rocks it is neither: the recommendation changes none of them."]
    reference = TUNED_POOL_HYB_H if TUNED_POOL_HYB_H in names else "hyb-h"
    d = strategy_difference(records, TUNED, reference, _ROWS["F 48"])
    if d is None:
        return []
    what = (
        "the weights"
        if THRESHOLDS in reset
        else "the thresholds"
        if {COVIS, B_AWARE} <= set(reset)
        else "both together"
    )
    against = "over Hyb-H in the tuned pool" if reference == TUNED_POOL_HYB_H else "over Hyb-H"
    if d.interval.excludes_zero and d.interval.mean > 0:
        verdict = f"On these rocks it is {what}: {_interval(d)} {against}"
    else:
        verdict = f"On these rocks {what} {'are' if what != 'both together' else 'earn'} " + (
            f"not shown to matter: {_interval(d)} {against}"
            if what != "both together"
            else f"{_interval(d)} {against}, which may be nothing"
        )
    alone = "" if not reset else f"; without effect or unchanged: {', '.join(reset)}"
    return [f"{begin} {verdict}{alone}."]


def _points(mean: float, low: float | None, high: float | None) -> str:
    """``+3.1 points [+1.2, +5.0]``."""
    said = f"{format_number(mean, 1, signed=True)} points of {metric_label('observable.f_score_48mm').name}"
    return (
        said
        if low is None
        else f"{said} [{format_number(low, 1, signed=True)}, {format_number(high, 1, signed=True)}]"
    )


def _interval(d: PairedDifference | None) -> str:
    """``+0.2 [−0.4, +0.8]``."""
    return MISSING if d is None else difference_text((d.interval.mean, d.interval.low, d.interval.high))


def difference_text(difference: tuple[float, float | None, float | None] | None) -> str:
    """``+0.2 [−0.4, +0.8]``; empty for none."""
    if difference is None:
        return ""
    mean, low, high = (format_number(value, 1, signed=True) for value in difference)
    return mean if difference[1] is None else f"{mean} [{low}, {high}]"


def gain_text(gain: tuple[float, tuple[float, float]]) -> str:
    """``+0.2 [−0.4, +0.8]``."""
    return difference_text((gain[0], *gain[1]))


# -- tables --------------------------------------------------------------------------------------------------


def cells(row: ResultRow) -> list[str]:
    """The row's texts: its name, its values, its difference from Hyb-H."""
    numbers = [format_number(value, _ROWS[column].decimals) for column, value in row.values.items()]
    return [row.label, *numbers, "reference" if row.strategy == "hyb-h" else difference_text(row.difference)]


def notes(block: ResultBlock) -> list[str]:
    """What a reader must know of single rows."""
    found = [f"{row.label}: {row.failed} failed, left out of the means." for row in block.rows if row.failed]
    found += [f"{row.label} took the same photographs as {row.same_as}." for row in block.rows if row.same_as]
    oracles = [row.label for row in block.rows if sees_ground_truth(row.strategy)]
    return (
        [*found, f"{', '.join(oracles)}: sees the true surface; no vehicle can run it."] if oracles else found
    )


def terminal_table(block: ResultBlock) -> Table:
    """One block, 80 columns wide at most."""
    table = Table(title=block.title, box=None, padding=(0, 1, 0, 0), title_justify="left")
    table.add_column("strategy", no_wrap=True)
    for column in _ROWS:
        table.add_column(column, justify="right", no_wrap=True)
    table.add_column("F 48 from Hyb-H", justify="right", no_wrap=True)
    kind = ""
    for row in block.rows:
        if row.kind != kind:
            kind = row.kind
            table.add_row(f"[italic]{kind}[/]")
        table.add_row(*cells(row))
    return table
