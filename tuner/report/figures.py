"""Figures of a campaign's page as data URIs: outcomes, slices of the model."""

from __future__ import annotations

import base64
import functools
import io
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from cycler import cycler
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Rectangle
from matplotlib.ticker import MaxNLocator

from nbv.config import MissionConfig
from nbv.rocks import DEFAULT_HEIGHT_M
from nbv.types import Floats
from nbv.viewpoints import raw_candidates, seed_viewpoints
from tuner.problem.observations import short
from tuner.problem.search_space import Parameter
from tuner.report.labels import Label, parameter_label
from tuner.surrogate.model import InstanceMeanGP

# One look for all figures: colour-blind-safe palette, print-friendly, no interactive backend.


matplotlib.use("Agg")


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


def embed(figure: Figure) -> str:
    """A figure as a data URI: each SVG is an image of its own, so that identifiers of two cannot clash in one page."""
    buffer = io.BytesIO()
    with look():
        figure.savefig(buffer, format="svg", dpi=160, metadata={"Date": None})
    return f"data:image/svg+xml;base64,{base64.b64encode(buffer.getvalue()).decode()}"


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


SLICE_POINTS = 61
BROWN, LIGHT_GREY = "#c9a98b", "#b8b8b8"


def plan_figure(config: MissionConfig) -> Figure:
    """A plan from above and from the side: seeds in blue, in grey where planned views may be, the target in brown."""
    low_m, high_m = config.pool.min_altitude_m, config.pool.max_altitude_m
    pool = [v for v in raw_candidates(config) if low_m <= v.position_m[2] <= high_m]
    with look():
        figure = new_figure(6.4, 3.4)
        above, beside = figure.subplots(1, 2)
        half = DEFAULT_HEIGHT_M / 2
        above.add_patch(Circle((0, 0), half, color=BROWN))
        beside.add_patch(Rectangle((-half, 0), 2 * half, 2 * half, color=BROWN))
        for views, shade, size in (
            (pool if config.planned_views else [], LIGHT_GREY, 2),
            (seed_viewpoints(config), BLUE, 4),
        ):
            east, north, up = np.array([v.position_m for v in views]).reshape(-1, 3).T
            above.plot(east, north, "o", color=shade, ms=size)
            beside.plot(east, up, "o", color=shade, ms=size)
        above.set(title="from above", xlabel="east (m)", ylabel="north (m)", aspect="equal")
        beside.set(title="from the side", xlabel="east (m)", ylabel="up (m)", aspect="equal")
    return figure


def draw_outcomes(
    trials: Mapping[str, Sequence[tuple[float, float | None, str]]],
    label: Label,
    x: str,
    sign: float = 0.0,
) -> str:
    """The outcome of every trial, a colour and a marker per instance; failed trials are crosses at the bottom.

    ``trials``: by the instance's name: position along ``x``, outcome (None: failed) and "default", "recommended" or
    nothing. ``sign``: 1 where more is better, -1 where less is: a line shows the best so far. 0: no line.
    """
    with look():
        figure = new_figure(6.4, 3.0)
        axis = figure.subplots()
        for k, (name, points) in enumerate(trials.items()):
            shade, shape = f"C{k}", MARKERS[k % len(MARKERS)]
            known = [(at, value, kind) for at, value, kind in points if value is not None]
            for kind, size, fill in (("", 4, "full"), ("default", 7, "none"), ("recommended", 9, "full")):
                marked = [(at, value) for at, value, which in known if which == kind]
                style: dict[str, Any] = {"color": shade, "ms": size, "fillstyle": fill, "clip_on": False}
                axis.plot(*np.array(marked).reshape(-1, 2).T, shape, rasterized=True, **style)
            axis.plot([], [], shape, color=shade, label=name)
            failed = [at for at, value, _ in points if value is None]
            axis.plot(
                failed, [0.03] * len(failed), "x", color=VERMILION, transform=axis.get_xaxis_transform()
            )
            if sign and known:
                best = sign * np.maximum.accumulate([sign * value for _, value, _ in known])
                axis.step([at for at, *_ in known], best, where="post", color=shade, linewidth=1)
        if label.unit == "%":
            axis.set_ylim(top=min(100.0, axis.get_ylim()[1]))
        axis.xaxis.set_major_locator(MaxNLocator(integer=True))
        axis.set(xlabel=x, ylabel=label.axis)
        if len(trials) < 11:
            figure.legend(loc="outside lower center", ncols=4)
        return embed(figure)


def draw_slices(
    model: InstanceMeanGP,
    parameters: Sequence[Parameter],
    values: Mapping[str, Any],
    label: Label,
    sign: float,
) -> list[str]:
    """The posterior of the mean over the instances along every parameter, the others as in ``values``; the steepest first.

    ``sign``: -1 where the model has the metric with its sign changed. Dots are the trials without their instance's offset.
    """
    offset = float(np.mean([model.standardiser.centre(instance.rock) for instance in model.instances]))
    outcomes = sign * (offset + model.mean_scale * np.asarray(model.targets))
    slices = []
    for p in parameters:
        at: list[Any] = list(p.choices)
        if p.kind != "categorical":
            at = sorted({p.from_unit(float(u)) for u in np.linspace(0.0, 1.0, SLICE_POINTS)})
        posterior = model.posterior([{**values, p.path: v} for v in at])
        slices.append((p, at, sign * np.asarray(posterior.mean), 1.96 * np.asarray(posterior.sd)))
    low = min(outcomes.min(), *(float((mean - half).min()) for *_, mean, half in slices))
    high = max(outcomes.max(), *(float((mean + half).max()) for *_, mean, half in slices))
    low, high = low - 0.03 * (high - low), high + 0.03 * (high - low)
    figures = []
    for p, at, mean, half in sorted(slices, key=lambda slice_: -float(np.ptp(slice_[2]))):
        position = p.choices.index if p.kind == "categorical" else float
        with look():
            figure = Figure(figsize=(2.8, 1.9))  # with margins of its own: half the time, of dozens
            figure.subplots_adjust(left=0.15, right=0.97, bottom=0.13, top=0.87)
            axis = figure.subplots()
            xs = [position(v) for v in at]
            axis.fill_between(xs, mean - half, mean + half, color=BLUE, alpha=0.15, linewidth=0)
            axis.plot(xs, mean, color=BLUE)
            dots = [position(o.values[p.path]) for o in model.observations]
            axis.plot(dots, outcomes, "o", color=GREY, ms=2.5, alpha=0.6, rasterized=True)
            axis.axvline(position(values[p.path]), color=BLACK, linestyle="--", linewidth=1)
            axis.set_ylim(low, min(high, 100.0) if label.unit == "%" else high)
            name = parameter_label(p.path)
            axis.set_title(name.name + (f" ({name.unit})" if name.unit else ""), fontsize=8.5)
            if p.kind == "categorical":
                axis.set_xticks(xs, [short(v) for v in at], fontsize=7.5)
            elif p.scale == "log":
                axis.set_xscale("log")
                axis.minorticks_off()
                axis.xaxis.set_major_formatter("{x:g}")
            figures.append(embed(figure))
    return figures


def draw_contour(
    fractions: Sequence[float],
    thresholds_m: Sequence[float],
    means: Floats,
    values: Mapping[str, Any],
    seen_m: tuple[float, float] | None,
    label: Label,
    sign: float,
) -> str:
    """The posterior mean over the gate's two thresholds, (d95, fraction), and between which d95 the gate switches.

    ``seen_m``: between which values d95 lay in flight: a threshold there, with a budget fraction below 1, makes the gate switch.
    """
    with look():
        figure = new_figure(4.4, 3.2)
        axis = figure.subplots()
        drawn = axis.contourf(fractions, thresholds_m, sign * means, levels=12, cmap=SEQUENTIAL)
        figure.colorbar(drawn, ax=axis, label=label.axis)
        if seen_m is not None:
            low, high = seen_m
            axis.fill_between([0, 1], low, high, facecolor="none", edgecolor="white", hatch="//", linewidth=0)
        axis.plot(values["gate.budget_fraction"], values["gate.d95_m"], "*", color=VERMILION, ms=12)
        axis.set(yscale="log", xlabel="budget fraction f_b", ylabel="threshold of d95 (m)")
        axis.grid(visible=False)
    return embed(figure)


def draw_best_so_far(points: Sequence[tuple[int, float]], label: Label) -> str:
    """The best posterior mean, by the final surrogate, of what had run by each trial."""
    with look():
        figure = new_figure(4.4, 3.2)
        axis = figure.subplots()
        axis.step(*np.array(points).T, where="post", color=BLUE)
        axis.set(xlabel="trial", ylabel=f"best {label.axis}")
        axis.xaxis.set_major_locator(MaxNLocator(integer=True))
    return embed(figure)
