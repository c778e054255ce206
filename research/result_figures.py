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
from matplotlib.axes import Axes

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


FIGURES: dict[str, Callable[[Path], plt.Figure]] = {"speed": speed}


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
