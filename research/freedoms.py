"""Which freedom is worth what: one change at a time to the paper's planner, on training rocks.

    OMP_NUM_THREADS=1 python -m research.freedoms --replicates 2 --out runs/freedoms \
        --rock slab --rock vesicular --rock cavern --rock breccia \
        --rock ../shared/rocks/apollo_15016_0/apollo_15016_0.obj --rock ../shared/rocks/apollo_65035_0/apollo_65035_0.obj

Prints a Markdown table of paired differences against Hyb-H. Nothing is tuned here, and held-out rocks are
refused: what this page suggests becomes a search space, and `gatetune evaluate` is its test. Finished missions are not
flown again; ``--report-only`` flies none.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from nbv.config import MissionConfig, preset
from nbv.errors import UserError
from research.paired_cells import difference_text, markdown_table
from tuner.campaign.rock_choice import rock_arguments
from tuner.comparison.plan import EvaluationPlan
from tuner.comparison.run import run_evaluation
from tuner.comparison.statistics import MetricRow, strategy_difference, strategy_interval
from tuner.missions.executors import LocalProcessExecutor
from tuner.missions.job import Trial
from tuner.problem.baselines import baseline

LOW = {"pool.max_altitude_m": 1.5}  # the 10 degree ring alone
NO_NOVELTY = {"covis.weights.nov": 0.0, "b_aware.weights.nov": 0.0}
VIEWS = "matchable.views"
ARMS: dict[str, tuple[str, dict[str, Any]]] = {  # name in the table: baseline, further values
    "Hyb-H": ("hyb-h", {}),
    "Hyb-H, no novelty": ("hyb-h", NO_NOVELTY),
    "Hyb-H, pool up to 2 m (10° and 15°)": ("hyb-h", {"pool.max_altitude_m": 2.0}),
    "Hyb-H, pool up to 1.5 m (10°)": ("hyb-h", LOW),
    "Covis, pool up to 1.5 m": ("covis", LOW),
    "Hyb-H, no novelty, pool up to 1.5 m": ("hyb-h", {**NO_NOVELTY, **LOW}),
    "Random": ("random", {}),
    "Random, pool up to 2 m": ("random", {"pool.max_altitude_m": 2.0}),
    "Random, pool up to 1.5 m": ("random", LOW),
    "Matchable, 3 views": ("matchable", {VIEWS: 3}),
    "Matchable, 6 views": ("matchable", {}),
    "Matchable, 9 views": ("matchable", {VIEWS: 9}),
    "Matchable, pool up to 1.5 m": ("matchable", LOW),
    "Greedy oracle, 3 views": ("greedy-oracle", {}),
    "Greedy oracle, 6 views": ("greedy-oracle", {"gate.oracle_matchable_views": 6}),
    "Greedy oracle, pool up to 1.5 m": ("greedy-oracle", LOW),
}
GROUP = "freedoms"
SHOWN = (
    MetricRow(GROUP, "F-score @ 48 mm, observable (%)", "observable.f_score_48mm", "%", True),
    MetricRow(GROUP, "completeness @ 48 mm, observable (%)", "observable.completeness_48mm", "%", True),
    MetricRow(GROUP, "mean C2C, observable (mm)", "observable.c2c_mean_mm", "mm", False),
    MetricRow(GROUP, "F-score @ 48 mm, whole (%)", "whole.f_score_48mm", "%", True),
    MetricRow(GROUP, "flight (s)", "costs.flight_time_s", "s", False, 0),
)


def arms(base: MissionConfig) -> dict[str, MissionConfig]:
    """Configurations by a name that may be a directory's."""
    return {
        file_name(title): baseline(name).config(base).with_values(values)
        for title, (name, values) in ARMS.items()
    }


def file_name(title: str) -> str:
    """``title`` in letters, digits and dashes."""
    return "-".join("".join(c if c.isalnum() and c.isascii() else " " for c in title).lower().split())


def table(records: list[Trial]) -> str:
    """One row per arm: mean F-score, then paired differences against Hyb-H."""
    rows = []
    reference = file_name("Hyb-H")
    for title in ARMS:
        name = file_name(title)
        mean = strategy_interval(records, name, SHOWN[0].key)
        cells = [title, "–" if mean is None else f"{mean.mean:.1f}"]
        for row in SHOWN:
            difference = strategy_difference(records, name, reference, row.key)
            own = difference_text(difference, row.decimals, bold=True)
            cells.append("reference" if name == reference else own)
        evaluated = sum(r.strategy == name and r.status != "failed" for r in records)
        rows.append([*cells, str(evaluated)])
    header = ["strategy", f"mean {SHOWN[0].label}", *(row.label for row in SHOWN), "missions"]
    return "\n".join(markdown_table(header, rows))


def figure(records: list[Trial], path: Path) -> None:
    """Forest plot of the first metric's paired differences."""
    from tuner.report.style import BLACK, BLUE, GREY, ORANGE, look, new_figure

    colours = {"Hyb-H": BLUE, "Covis": BLUE, "Random": GREY, "Matchable": ORANGE, "Greedy oracle": BLACK}
    titles = [title for title in ARMS if title != "Hyb-H"]
    with look():
        sheet = new_figure(7.2, 4.6)
        ax = sheet.subplots()
        ax.axvline(0.0, color=GREY, lw=0.8)
        for y, title in enumerate(reversed(titles)):
            d = strategy_difference(records, file_name(title), file_name("Hyb-H"), SHOWN[0].key)
            if d is None or d.low is None or d.high is None:
                continue
            ax.plot([d.low, d.high], [y, y], color=colours[title.split(",")[0]], lw=1.6)
            ax.plot(d.mean, y, "o", color=colours[title.split(",")[0]], ms=5)
        ax.set_yticks(range(len(titles)), list(reversed(titles)))
        ax.set_xlabel("F-score @ 48 mm, observable: points over Hyb-H, 95 %")
        sheet.savefig(path, dpi=150)


def main() -> None:
    """Fly and print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--rock", action="append", required=True)
    parser.add_argument("--replicates", type=int, default=2)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--out", type=Path, default=Path("runs/freedoms"))
    parser.add_argument("--report-only", action="store_true")
    parser.add_argument("--figure", type=Path)
    arguments = parser.parse_args()
    try:
        rocks = tuple(rock_arguments(arguments.rock, tuned=True))
    except UserError as error:
        parser.error(str(error))
    plan = EvaluationPlan(arms(preset("campaign")), rocks, arguments.replicates)
    if not arguments.report_only:
        with LocalProcessExecutor(arguments.workers) as executor:
            run_evaluation(
                plan,
                arguments.out,
                executor,
                lambda e: print(f"{e.finished}/{e.total}", end="\r", flush=True),
            )
    records = plan.records(arguments.out)
    print(table(records))
    if arguments.figure is not None:
        figure(records, arguments.figure)


if __name__ == "__main__":
    main()
