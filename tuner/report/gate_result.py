"""What tuning the gate gained over the paper's strategies and the controls: a table and sentences, for terminal, page and JSON."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

from tuner.campaign.campaign import Campaign
from tuner.comparison.advice import Results, held_out_results, training_results
from tuner.comparison.statistics import (
    ComparisonTable,
    Interval,
    MetricRow,
    comparison_table,
    strategy_difference,
)
from tuner.missions.job import Trial
from tuner.problem.baselines import (
    B_AWARE,
    CHOICE,
    COVIS,
    THRESHOLDS,
    TUNED,
    TUNED_POOL_HYB_H,
    TUNED_WEIGHTS,
    grouped,
    in_table_order,
    kind_of,
    label,
    sees_ground_truth,
)
from tuner.recommendation.recommendation import Recommendation
from tuner.report.answer import there
from tuner.report.labels import counted, difference_text, format_number
from tuner.report.style import short_names
from tuner.report.table import Cell, Row, Table

F_48 = "observable.f_score_48mm"
_COLUMNS = (
    MetricRow("", "photos", "costs.images", "", False, 0),
    MetricRow("", "flight", "costs.flight_time_s", "s", False, 0),
    MetricRow("", "F 48", F_48, "%", True),
    MetricRow("", "F 80", "observable.f_score_80mm", "%", True),
    MetricRow("", "C 48", "observable.completeness_48mm", "%", True),
    MetricRow("", "C 80", "observable.completeness_80mm", "%", True),
    MetricRow("", "C2C", "observable.c2c_mean_mm", "mm", False),
)
LEGEND = (
    "F is the F-score and C the completeness (%) at 48 and 80 mm, C2C the mean distance from the surface to the cloud (mm), "
    "flight in s; all are of the observable surface. The last column is the paired difference of the F-score at 48 mm from Hyb-H, "
    "in points, with its 95 % interval."
)


@dataclass(frozen=True)
class ResultBlock:
    """All strategies on one set of rocks."""

    results: Results = field(repr=False, compare=False)
    table: ComparisonTable

    @property
    def rocks(self) -> tuple[str, ...]:
        """The rocks on which the recommendation has run."""
        return self.results.rocks

    @property
    def title(self) -> str:
        """``Held-out rocks: arch, fin (3 replicates)``."""
        least, most = self.results.replicates[0], self.results.replicates[-1]
        replicates = counted(most, "replicate") if least == most else f"{least} to {most} replicates"
        what, again = ("Held-out rocks", "") if self.results.held_out else ("Training rocks", ", tuned on")
        return f"{what}: {', '.join(short_names(self.rocks))} ({replicates}{again})"

    @property
    def there(self) -> str:
        """``2 held-out rocks``."""
        return there(self.results)

    def gain(self, strategy: str, reference: str = "hyb-h") -> Interval | None:
        """The paired difference of the F-score at 48 mm."""
        return strategy_difference(self.results.records, strategy, reference, F_48)

    def to_dict(self) -> dict[str, Any]:
        """For JSON (`nbv.convert.json_ready`)."""
        own = self.results
        return {
            "rocks": self.rocks,
            "held_out": own.held_out,
            "replicates": own.replicates,
            "complete": own.complete,
            "table": self.table,
        }


@dataclass(frozen=True)
class GateResult:
    """The table and what it says."""

    blocks: list[ResultBlock]  # held-out rocks first
    sentences: list[str]

    def to_dict(self) -> dict[str, Any]:
        """For JSON (`nbv.convert.json_ready`)."""
        return {"blocks": [block.to_dict() for block in self.blocks], "sentences": self.sentences}


def gate_result(campaign: Campaign, best: Recommendation | None = None) -> GateResult | None:
    """Return all strategies beside the present recommendation, from everything in the run directory; None without evaluation."""
    s, best = campaign.settings, best or campaign.recommendation(save=False)
    found = None if best is None else held_out_results(campaign, s.problem.config(best.values))
    if best is None or found is None or not _against_hyb_h(found):
        return None
    training = training_results(campaign, best)
    blocks = [_block(results) for results in (found, training) if _against_hyb_h(results)]
    return GateResult(blocks, _what_was_found(blocks, best))


def _against_hyb_h(results: Results) -> bool:
    return bool(results.records) and "hyb-h" in results.strategies


def _block(results: Results) -> ResultBlock:
    names = in_table_order(results.strategies)
    return ResultBlock(results, comparison_table(results.records, names, "hyb-h", _COLUMNS))


# -- sentences -----------------------------------------------------------------------------------------------


def _what_was_found(blocks: Sequence[ResultBlock], best: Recommendation) -> list[str]:
    """Return the gain on held-out and on training rocks, what earned it, and whether the paper's gate did anything."""
    block, said = blocks[0], list[str]()
    if not best.keep_default:
        also = [f", and {difference_text(other.gain(TUNED))} on {other.there}" for other in blocks[1:]]
        said = [
            f"On {block.there} Tuned gains {difference_text(block.gain(TUNED))} points of F-score at 48 mm over Hyb-H{''.join(also)}.",
            *_what_earned_it(block, best.changed),
        ]
    if same := block.table.same.get("hyb-h"):
        said.append(
            f"On the {block.there} Hyb-H took the photographs of {label(same)} in every mission: its gate had no effect."
        )
    return said


@dataclass(frozen=True)
class Step:
    """One part of the way from Hyb-H to the tuned configuration, by missions on the same rocks and replicates."""

    groups: list[str]  # of parameters, which this step changes
    strategy: str
    gain: Interval | None  # over the step before; None where the two have no mission in common


def measured_steps(records: Sequence[Trial], strategies: Sequence[str], changed: Sequence[str]) -> list[Step]:
    """Return the gain over Hyb-H step by step: pool (with seeds and stop), weights, thresholds, as far as each was run."""
    groups = grouped(changed)
    elsewhere = [name for name in groups if name not in CHOICE]
    weights = [name for name in groups if name in CHOICE and name != THRESHOLDS]
    thresholds = [name for name in groups if name == THRESHOLDS]
    stages = [(TUNED_POOL_HYB_H, elsewhere), (TUNED_WEIGHTS, weights), (TUNED, thresholds)]
    steps, before, waiting = list[Step](), "hyb-h", list[str]()
    for strategy, names in stages:
        waiting += names
        if strategy in strategies and waiting:
            steps.append(Step(waiting, strategy, strategy_difference(records, strategy, before, F_48)))
            before, waiting = strategy, []
    return steps


def _what_earned_it(block: ResultBlock, changed: Sequence[str]) -> list[str]:
    """Return the gain step by step, and whether it is from what the paper suspects: thresholds, or weights shared by the scorers."""
    steps = measured_steps(block.results.records, block.table.strategies, changed)
    if missing := [label(step.strategy) for step in steps if step.gain is None]:
        return [
            f"What earned the gain is not known yet: {' and '.join(missing)} did not finish on these rocks."
        ]
    parts = [f"{' and '.join(step.groups)} {difference_text(step.gain)}" for step in steps]
    suspects = {"the thresholds": (THRESHOLDS,), "the shared weights": (COVIS, B_AWARE)}
    found, without = list[str](), list[str]()
    for suspect, own in suspects.items():
        gain = next((step.gain for step in steps if set(own) & set(step.groups)), None)
        if gain is None:
            without.append(suspect)
        elif gain.low is not None and round(gain.low, 1) > 0:
            found.append(f"{suspect}, {difference_text(gain)} points")
    verdict = f"it is {' and '.join(found)}" if found else "neither is shown to be one"
    none = f" ({' and '.join(without)} stayed at the paper's values)" if without else ""
    return [
        f"Step by step, this was earned by: {'; '.join(parts)}.",
        f"The paper names the thresholds and the shared weights as causes: on these rocks {verdict}{none}.",
    ]


# -- tables --------------------------------------------------------------------------------------------------


def table_of(block: ResultBlock) -> Table:
    """One set of rocks, 80 columns wide at most; a column that no mission has a value of is left out."""
    table = block.table
    columns = [row for row in table.rows if any(row.cells.values())]
    rows: list[Row] = []
    kind = ""
    for name in table.strategies:
        if kind_of(name) != kind:
            kind = kind_of(name)
            rows.append(Row(kind))
        means = [None if (own := row.cells[name]) is None else own.mean for row in columns]
        texts = [format_number(mean, row.metric.decimals) for mean, row in zip(means, columns)]
        texts.append("reference" if name == "hyb-h" else difference_text(block.gain(name)))
        rows.append(Row(label(name), tuple(map(Cell, texts)), best=name == TUNED))
    notes = [
        f"{label(name)}: {failed} failed missions are left out of the means."
        for name, failed in table.failures.items()
        if failed
    ]
    notes += [
        f"{label(name)} took the same photographs as {label(same)}." for name, same in table.same.items()
    ]
    if oracles := [label(name) for name in table.strategies if sees_ground_truth(name)]:
        see = "sees" if len(oracles) == 1 else "see"
        notes.append(f"{' and '.join(oracles)} {see} the true surface, which a vehicle does not know.")
    title = block.title if block.results.complete else f"{block.title}, not complete"
    names = (row.metric.label for row in columns)
    return Table(title, ("strategy", *names, "F 48 from Hyb-H"), rows, " ".join(notes))
