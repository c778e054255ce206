"""Draws the figures of the results pages that are made from their CSV files alone.

    python -m research.result_figures [NAME ...] [--data docs/results/data] [--out docs/images]

Every figure is a function of one or two files in ``docs/results/data``; no mission is run. NAME is a figure's name,
all of them unless given.
"""

import argparse
from collections.abc import Callable
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt

from research import read_rows

BLUE, GREY = "#0072B2", "#777777"


def speed(data: Path) -> plt.Figure:
    """CPU seconds of a paper mission, the authors' way and ours."""
    rows = read_rows(data / "speed_authors_way.csv")
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
