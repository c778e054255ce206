"""What tuning the gate earned: one table beside the paper's strategies and the controls, and sentences, for terminal, page and JSON."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tuner.campaign.campaign import Campaign
from tuner.evaluation.comparison import (
    MetricRow,
    PairedDifference,
    same_photographs,
    strategy_difference,
    strategy_interval,
)
from tuner.evaluation.earned import measured_steps
from tuner.evaluation.of_campaign import HELD_OUT, TRAINING, evaluations
from tuner.evaluation.plan import EvaluationPlan
from tuner.missions.job import Trial
from tuner.problem.baselines import (
    B_AWARE,
    CONTROLS,
    COVIS,
    THRESHOLDS,
    TUNED,
    grouped,
    in_table_order,
    kind_of,
    label,
    sees_ground_truth,
)
from tuner.recommendation.recommendation import Recommendation
from tuner.report.labels import MISSING, Difference, counted, difference_text, format_number
from tuner.report.style import short_names
from tuner.report.table import Cell, Row, Table

_ROWS = {
    "photos": MetricRow("", "Photographs", "costs.images", "", False, 0),
    "flight": MetricRow("", "Flight", "costs.flight_time_s", "s", False, 0),
    "F 48": MetricRow("", "F-score, 48 mm", "observable.f_score_48mm", "%", True),
    "F 80": MetricRow("", "F-score, 80 mm", "observable.f_score_80mm", "%", True),
    "C 48": MetricRow("", "Completeness, 48 mm", "observable.completeness_48mm", "%", True),
    "C 80": MetricRow("", "Completeness, 80 mm", "observable.completeness_80mm", "%", True),
    "C2C": MetricRow("", "Mean C2C", "observable.c2c_mean_mm", "mm", False),
}
LEGEND = (
    "F is the F-score and C the completeness (%) at 48 and 80 mm, C2C the mean distance from cloud to surface (mm), flight "
    "in s; all are of the observable surface. The last column is the paired difference of the F-score at 48 mm from Hyb-H, "
    "in points, with its 95 % interval."
)


@dataclass(frozen=True)
class ResultRow:
    """One strategy on one set of rocks."""

    strategy: str
    label: str
    kind: str  # see `kind_of`
    values: dict[str, float | None]  # by column
    difference: Difference | None  # of the F-score at 48 mm from Hyb-H
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
        again = "" if self.held_out else ", tuned on"
        return f"{what}: {names} ({counted(self.replicates, 'replicate')}{again})"


@dataclass(frozen=True)
class GateResult:
    """The table and what it says."""

    blocks: list[ResultBlock]  # held-out rocks first
    sentences: list[str]

    def to_dict(self) -> dict[str, Any]:
        """JSON form; differences and gains in F-score points, positive where better."""
        return dataclasses.asdict(self)


def gate_result(campaign: Campaign) -> GateResult | None:
    """Return the comparison of the present recommendation, from the evaluations in its run directory; None without one."""
    s, best = campaign.settings, campaign.recommendation(save=False)
    if best is None:
        return None
    tuned, sources = s.config(best.values), list[tuple[ResultBlock, list[Trial]]]()
    for held_out, name in ((True, HELD_OUT), (False, TRAINING)):
        found = [
            _block(directory, plan, held_out)
            for directory, plan in evaluations(campaign, name, tuned)
            if "hyb-h" in plan.strategies
        ]
        if found:  # the complete one with the most rocks stands for all
            sources.append(
                max(found, key=lambda pair: (pair[0].complete, len(pair[0].rocks), pair[0].replicates))
            )
    return GateResult([block for block, _ in sources], _sentences(sources, best)) if sources else None


def _block(directory: Path, plan: EvaluationPlan, held_out: bool) -> tuple[ResultBlock, list[Trial]]:
    records, names = plan.records(directory), in_table_order(plan.strategies)
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
                None if d is None else d.bounds,
                label(same[name]) if name in same else "",
                sum(r.status != "failed" for r in own),
                sum(r.status == "failed" for r in own),
            )
        )
    expected = len(plan.strategies) * len(plan.instances) * plan.replicates
    block = ResultBlock(plan.rocks, held_out, plan.replicates, rows, len(records) == expected, directory.name)
    return block, records


# -- sentences -----------------------------------------------------------------------------------------------


def _sentences(sources: Sequence[tuple[ResultBlock, list[Trial]]], best: Recommendation) -> list[str]:
    """Return what the table says: the gain, what earned it, the best control, what the gate did."""
    block, records = sources[0]
    rows, metric = {row.strategy: row for row in block.rows}, _ROWS["F 48"]
    there = counted(len(block.rocks), "held-out rock" if block.held_out else "training rock")
    if best.keep_default:
        said = ["The campaign found nothing better than Hyb-H at its default: Tuned is Hyb-H."]
    else:
        also = [
            f", and {difference_text(_row(other, TUNED).difference)} on {counted(len(other.rocks), 'training rock')}"
            for other, _ in sources[1:]
        ]
        said = [
            f"On {there} Tuned gains {difference_text(rows[TUNED].difference)} points of F-score at 48 mm over Hyb-H{''.join(also)}.",
            *_what_earned_it(block, records, best),
        ]
    controls = {
        row.strategy: row.values["F 48"] or 0.0
        for row in block.rows
        if row.kind == CONTROLS and row.values["F 48"] is not None
    }
    if controls:
        name = max(controls, key=lambda control: controls[control])
        d = strategy_difference(records, TUNED, name, metric)
        said.append(
            f"The best control on the {there} is {label(name)}; Tuned's difference from it is {_interval(d)} points."
        )
    if rows["hyb-h"].same_as:
        said.append(
            f"On the {there} Hyb-H took the photographs of {rows['hyb-h'].same_as} in every mission: its gate had no effect."
        )
    return said


def _what_earned_it(block: ResultBlock, records: list[Trial], best: Recommendation) -> list[str]:
    """Return the gain step by step, and which of the paper's two suspects it is: thresholds, or weights shared by the scorers."""
    names = [row.strategy for row in block.rows]
    steps = measured_steps(records, names, "hyb-h", _ROWS["F 48"], best.changed)
    if missing := [label(step.strategy) for step in steps if step.difference is None]:
        return [
            f"What earned it is not known yet: {' and '.join(missing)} did not run on these rocks to the end."
        ]
    parts = [f"{step.what} {_interval(step.difference)}" for step in steps]
    said = [f"Step by step, this was earned by: {'; '.join(parts)}."]
    groups = grouped(best.changed)
    suspects = {"the thresholds": (THRESHOLDS,), "the shared weights": (COVIS, B_AWARE)}
    found, without = list[str](), list[str]()
    for suspect, own in suspects.items():
        if not set(own) & set(groups):
            without.append(suspect)
            continue
        step = next(step for step in steps if any(group in step.what for group in own))
        d = step.difference
        if d is not None and d.interval.low is not None and round(d.interval.low, 1) > 0:
            found.append(f"{suspect}, {_interval(d)} points")
    verdict = f"it is {' and '.join(found)}" if found else "neither is shown to be one"
    none = f" ({' and '.join(without)} stay at the paper's values)" if without else ""
    said.append(
        f"The paper names the thresholds and the shared weights as causes: on these rocks {verdict}{none}."
    )
    return said


def _row(block: ResultBlock, strategy: str) -> ResultRow:
    return next(row for row in block.rows if row.strategy == strategy)


def _interval(d: PairedDifference | None) -> str:
    """``+0.2 [−0.4, +0.8]``."""
    return MISSING if d is None else difference_text(d.bounds)


# -- tables --------------------------------------------------------------------------------------------------


def table_of(block: ResultBlock) -> Table:
    """One set of rocks, 80 columns wide at most; a column that no mission has a value of is left out."""
    columns = [name for name in _ROWS if any(row.values[name] is not None for row in block.rows)]
    rows: list[Row] = []
    kind = ""
    for row in block.rows:
        if row.kind != kind:
            kind = row.kind
            rows.append(Row(kind))
        texts = [format_number(row.values[name], _ROWS[name].decimals) for name in columns]
        texts.append("reference" if row.strategy == "hyb-h" else difference_text(row.difference))
        rows.append(Row(row.label, tuple(map(Cell, texts)), best=row.strategy == TUNED))
    notes = [
        f"{row.label}: {row.failed} failed missions are left out of the means."
        for row in block.rows
        if row.failed
    ]
    notes += [f"{row.label} took the same photographs as {row.same_as}." for row in block.rows if row.same_as]
    if oracles := [row.label for row in block.rows if sees_ground_truth(row.strategy)]:
        see = "sees" if len(oracles) == 1 else "see"
        notes.append(f"{' and '.join(oracles)} {see} the true surface, which a vehicle does not know.")
    title = block.title if block.complete else f"{block.title}, not complete"
    return Table(title, ("strategy", *columns, "F 48 from Hyb-H"), rows, " ".join(notes))
