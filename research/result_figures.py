"""Draws the figures of the results pages that are made from their CSV files alone.

    python -m research.result_figures [NAME ...] [--data docs/results/data] [--out docs/images]

Every figure is a function of one or two files in ``docs/results/data``; no mission is run. NAME is a figure's name,
all of them unless given.
"""

import argparse
import csv
from collections.abc import Callable
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes

from nbv.rocks.families import HELD_OUT_FROM
from tuner.report.style import CYCLE

Row = dict[str, str]
NAMES = {"optuna-gp": "Optuna's GP", "smac": "SMAC3", "ax": "Ax", "tpe": "TPE", "hebo": "HEBO"}
WAYS = {"": "", "all": ", all rocks each", "pruned": ", pruned"}  # how a peer runs many rocks
BLUE, ORANGE, GREEN, GREY = "#0072B2", "#D55E00", "#009E73", "#777777"


def read(data: Path, name: str) -> list[Row]:
    """Rows of ``data/name.csv``."""
    with (data / f"{name}.csv").open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def forest(
    axes: Axes, labels: list[str], values: list[tuple[float, float, float]], colour: str = BLUE
) -> None:
    """One line per label: value with its interval (low, high); the first label on top."""
    for place, (value, low, high) in enumerate(values):
        axes.plot([low, high], [place, place], color=colour, linewidth=2)
        axes.plot(value, place, "o", color=colour)
    axes.axvline(0, color="black", linewidth=0.8)
    axes.set_yticks(range(len(labels)), labels)
    axes.invert_yaxis()
    axes.grid(axis="x", alpha=0.3)


def with_interval(row: Row, column: str) -> tuple[float, float, float]:
    """Value, lower and upper end of a column that the file holds as three."""
    return float(row[column]), float(row[f"{column}, low"]), float(row[f"{column}, high"])


def label(strategy: str) -> str:
    """What a reader calls a peer that the benchmark calls ``name`` or ``name/way``."""
    name, _, way = strategy.partition("/")
    return NAMES[name] + WAYS[way]


def optimisers(data: Path) -> plt.Figure:
    """Ours minus each peer, 18 parameters, two Apollo rocks."""
    column = "ours minus this (mean, 95 %)"
    rows = [
        row
        for row in read(data, "optimisers")
        if row["problem"] == "geometric, full, two Apollo rocks" and row[column]
    ]
    rows.sort(key=lambda row: float(row[column]))
    figure, axes = plt.subplots(figsize=(7, 3.4))
    forest(
        axes,
        [f"{label(row['strategy'])} ({row['seeds']} seeds)" for row in rows],
        [with_interval(row, column) for row in rows],
    )
    axes.set_xlabel("ours minus this, F-score (points), 95 %")
    return figure


def conditions(data: Path) -> plt.Figure:
    """F-score on every held-out rock in conditions that no campaign has seen, by what was tuned where."""
    rows = read(data, "unseen_conditions")
    names = {
        "hyb-h": "Hyb-H, paper's values",
        "random-in-its-pool": "random views below 3.16 m",
        "tuned-ideal": "tuned in ideal",
        "tuned-conditions": "tuned over conditions",
        "tuned-there": "tuned in harsh itself",
    }
    instances = list(dict.fromkeys(row["condition"] for row in rows))
    figure, panels = plt.subplots(1, len(instances), figsize=(8, 2.8), sharey=True)
    for axes, instance in zip(panels, instances):
        for place, strategy in enumerate(names):
            found = [row for row in rows if (row["strategy"], row["condition"]) == (strategy, instance)]
            values = [float(row["f_score_48mm"]) for row in found if row["f_score_48mm"]]
            if not values:
                continue
            axes.plot(values, [place] * len(values), "o", color=GREY, alpha=0.5, markersize=4)
            axes.plot(sum(values) / len(values), place, "D", color=BLUE if "tuned" in strategy else ORANGE)
        axes.set_title(instance)
        axes.set_xlabel("registered F-score @ 48 mm (%)")
        axes.grid(axis="x", alpha=0.3)
    panels[0].set_yticks(range(len(names)), list(names.values()))
    panels[0].invert_yaxis()
    return figure


def speed(data: Path) -> plt.Figure:
    """CPU seconds of a paper mission, the authors' way and ours."""
    rows = read(data, "speed_authors_way")
    labels = ["authors' way", "ours, nothing cached", "ours, warm, new views", "ours, warm, known views"]
    seconds = [float(row["total"].replace(",", "")) for row in rows]
    figure, axes = plt.subplots(figsize=(7, 2.4))
    bars = axes.barh(labels, seconds, color=[GREY, BLUE, BLUE, BLUE])
    axes.bar_label(bars, [f"{value:g} s" for value in seconds], padding=3)
    axes.set_xscale("log")
    axes.set_xlim(1, 6000)
    axes.invert_yaxis()
    axes.set_xlabel("CPU seconds, 24 + 40 captures, one thread")
    return figure


def where_planning_pays(data: Path) -> plt.Figure:
    """Gain of the adaptive plan over an orbit of as many photographs: by how hard the rock is, and by condition."""
    figure, (hard, instances) = plt.subplots(1, 2, figsize=(9, 3.8), sharey=True, layout="constrained")
    arms = ("rings at 10° and 35°", "adaptive")
    scores: dict[str, dict[str, float]] = {}
    for row in read(data, "where_planning_pays"):
        held_out = int(row["rock"].rpartition("-")[2]) >= HELD_OUT_FROM
        if held_out and row["value"] == "f_score" and row["arm"] in arms:
            scores.setdefault(row["rock"], {})[row["arm"]] = float(row["24"])
    pairs = [(of[arms[0]], of[arms[1]] - of[arms[0]]) for of in scores.values() if len(of) == 2]
    hard.scatter(*zip(*pairs, strict=True), s=14, color=BLUE, alpha=0.6, label="geometric")
    evaluated: dict[str, dict[str, dict[str, float]]] = {}
    for row in read(data, "where_planning_pays_photographs"):
        if row["status"].endswith("failed"):
            continue  # no cloud; the page says so
        evaluated.setdefault(row["condition"], {}).setdefault(row["rock"], {})[row["arm"]] = float(
            row["f_score"]
        )
    gains = {
        name: [
            (max(orbits), of["adaptive"] - max(orbits))
            for of in rocks.values()
            if "adaptive" in of and (orbits := [f for arm, f in of.items() if arm.startswith("two rings")])
        ]
        for name, rocks in evaluated.items()
    }
    hard.scatter(
        *zip(*gains["ideal"], strict=True), s=34, marker="D", color=ORANGE, alpha=0.8, label="photographs"
    )
    hard.axvline(98, color=GREY, linewidth=0.8, linestyle=":")
    hard.set_xlabel("F-score of the orbit of 24 (%), ideal")
    hard.set_ylabel("adaptive plan minus orbit (points)")
    hard.legend(fontsize=8, loc=(0.25, 0.05))
    rng = np.random.default_rng(0)
    for place, (_, of) in enumerate(gains.items()):
        gain = np.array([difference for _, difference in of])
        means = gain[rng.integers(0, len(gain), (4000, len(gain)))].mean(axis=1)
        instances.scatter(place + rng.uniform(-0.12, 0.12, len(gain)), gain, s=14, color=ORANGE, alpha=0.6)
        low, high = np.percentile(means, [2.5, 97.5])
        instances.errorbar(
            place + 0.3,
            gain.mean(),
            [[gain.mean() - low], [high - gain.mean()]],
            fmt="o",
            color="black",
            capsize=3,
            markersize=4,
        )
    instances.set_xticks(
        range(len(gains)),
        [name.replace(" (", "\n(") + f"\n{len(of)} rocks" for name, of in gains.items()],
        fontsize=8,
    )
    instances.set_yscale("symlog", linthresh=2)
    ticks = (-10, -5, -2, -1, 0, 1, 2, 5, 10, 20)
    instances.set_yticks(ticks, [str(tick) for tick in ticks])
    instances.minorticks_off()
    instances.set_title("24 or 26 photographs; mean and 95 % interval", fontsize=9)
    for axes in (hard, instances):
        axes.axhline(0, color="black", linewidth=0.8)
        axes.grid(alpha=0.3)
    return figure


def planners_against_orbits(data: Path) -> plt.Figure:
    """Share of the targets at 98 % and mean F-score over the number of photographs, by strategy."""
    figure, axes = plt.subplots(1, 2, figsize=(9.5, 4.4), layout="constrained")
    strategies: dict[str, list[Row]] = {}
    for row in read(data, "planners_against_orbits"):
        strategies.setdefault(row["strategy"], []).append(row)
    for index, (name, rows) in enumerate(strategies.items()):
        photographs = [float(row["photographs"]) for row in rows]
        f_scores = [float(row["f_score_percent"]) for row in rows]
        style = ":" if name.startswith("orbit") else "--" if name == "greedy-oracle" else "-"
        own: dict[str, Any] = {"color": CYCLE[index % len(CYCLE)], "linewidth": 1.6}
        axes[0].plot(photographs, [100 * float(row["share"]) for row in rows], style, **own, label=name)
        axes[1].plot(photographs, f_scores, style, **own)
    axes[0].set_ylabel("targets with an F-score of 98 % (%)")
    axes[1].set_ylabel("mean F-score at 48 mm (%)")
    axes[1].set_ylim(90, 100)
    for each in axes:
        each.set_xlabel("photographs (mean)")
        each.set_xlim(12, 48)
        each.grid(alpha=0.3)
    figure.legend(loc="outside lower center", ncols=4, fontsize=8)
    return figure


FIGURES: dict[str, Callable[[Path], plt.Figure]] = {
    figure.__name__: figure
    for figure in (optimisers, conditions, where_planning_pays, planners_against_orbits, speed)
}


def main() -> None:
    """Draw the figures named on the command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"of {', '.join(FIGURES)}")
    parser.add_argument("--data", type=Path, default=Path("docs/results/data"))
    parser.add_argument("--out", type=Path, default=Path("docs/images"))
    given = parser.parse_args()
    unknown = set(given.names) - set(FIGURES)
    if unknown:
        parser.error(f"no such figure: {', '.join(sorted(unknown))}; there are {', '.join(FIGURES)}")
    for name in given.names or FIGURES:
        figure = FIGURES[name](given.data)
        figure.savefig(given.out / f"{name}.png", dpi=110, bbox_inches="tight", metadata={"Software": None})
        plt.close(figure)


if __name__ == "__main__":
    main()
