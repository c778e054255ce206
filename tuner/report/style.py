"""One look for all figures: colour-blind-safe palette, print-friendly, no interactive backend."""

from __future__ import annotations

import base64
import functools
import io
from pathlib import Path
from typing import Literal

import matplotlib
from cycler import cycler

matplotlib.use("Agg")

from matplotlib.figure import Figure

from nbv.safe_files import write_atomic

# Okabe and Ito, "Color universal design" (2008); yellow left out, too light on white paper.
BLUE, ORANGE, GREEN = "#0072B2", "#E69F00", "#009E73"
VERMILION, PURPLE, SKY, BLACK = "#D55E00", "#CC79A7", "#56B4E9", "#000000"
# Eleven, one more than the colours: no pair of colour and marker repeats among 110 series.
MARKERS = ("o", "s", "^", "D", "v", "P", "h", "<", ">", "p", "*")
GREY, LIGHT = "#6b6b6b", "#e9ecef"
# Ten series: as many as an evaluation compares by default. The last two are Tol's wine and olive.
CYCLE = (BLUE, VERMILION, GREEN, PURPLE, ORANGE, SKY, BLACK, "#999999", "#882255", "#999933")
SEQUENTIAL = "cividis"  # uniform, readable without colour vision

_RC = {
    "font.family": "DejaVu Sans",
    "font.size": 9.5,
    "axes.titlesize": 10,
    "axes.labelsize": 9.5,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.edgecolor": "#444444",
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": "#dfdfdf",
    "grid.linewidth": 0.6,
    "legend.frameon": False,
    "legend.fontsize": 8.5,
    "xtick.labelsize": 8.5,
    "ytick.labelsize": 8.5,
    "figure.facecolor": "white",
    "savefig.facecolor": "white",
    "svg.fonttype": "path",
    "svg.hashsalt": "gatetune",  # the same figure gives the same file
    "axes.prop_cycle": cycler(color=CYCLE),
}


# A context in which figures have this look; matplotlib's settings are restored afterwards.
look = functools.partial(matplotlib.rc_context, _RC)


def embed(figure: Figure, form: Literal["svg", "png"] = "svg") -> str:
    """A figure as a data URI: each SVG is an image of its own, so that identifiers of two cannot clash in one page."""
    buffer = io.BytesIO()
    with look():
        figure.savefig(buffer, format=form, dpi=160, metadata={"Date": None} if form == "svg" else None)
    kind = "image/svg+xml" if form == "svg" else "image/png"
    return f"data:{kind};base64,{base64.b64encode(buffer.getvalue()).decode()}"


def save_figure(figure: Figure, directory: Path, name: str) -> Path:
    """Write ``directory/NAME.png``, the same bytes for the same figure; returns its path."""
    path, buffer = directory / f"{name}.png", io.BytesIO()
    with look():
        figure.savefig(buffer, dpi=160, metadata={"Software": None})
    write_atomic(path, buffer.getbuffer())
    return path


def new_figure(width_in: float, height_in: float) -> Figure:
    """A figure that keeps its labels apart; not registered with pyplot, so nothing has to be closed."""
    return Figure(figsize=(width_in, height_in), layout="constrained")
