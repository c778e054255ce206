"""Draws the figures of the results pages that are made from their CSV files alone.

    python -m research.result_figures [NAME ...] [--data docs/results/data] [--out docs/images]

Every figure is a function of one or two files in ``docs/results/data``; no mission is run. NAME is a figure's name,
all of them unless given.
"""

import argparse
import csv
from collections.abc import Callable
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes

from nbv.rocks.families import HELD_OUT_FROM

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


FIGURES: dict[str, Callable[[Path], plt.Figure]] = {
    figure.__name__: figure for figure in (where_planning_pays, speed)
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
