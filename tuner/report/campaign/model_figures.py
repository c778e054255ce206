"""Figures of what a campaign's model says. Each takes the facts and returns a matplotlib figure."""

from __future__ import annotations

import textwrap
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullFormatter

from tuner.problem.search_space import Parameter
from tuner.report.campaign.facts import CampaignFacts
from tuner.report.labels import parameter_label
from tuner.report.style import (
    BLACK,
    GREY,
    ORANGE,
    PURPLE,
    SEQUENTIAL,
    VERMILION,
    colour,
    look,
    marker,
    new_figure,
)
from tuner.surrogate.numerics import NORMAL_95


def map_figure(facts: CampaignFacts) -> Figure | None:
    """Posterior mean and standard deviation over two parameters; None where fewer than two are ordered."""
    surface = facts.surface
    if surface is None:
        return None
    assert facts.recommendation is not None
    x, y = surface.x.path, surface.y.path
    with look():
        figure = new_figure(9.2, 4.5)
        axes = figure.subplots(1, 2, sharey=True)
        label = facts.label
        panels = (
            (surface.mean, f"posterior mean: {label.name}", label.unit, SEQUENTIAL),
            (surface.sd, "posterior standard deviation", label.difference_unit, "Greys"),
        )
        done = [t for t in facts.trials if t.state != "running"]
        for ax, (field, title, unit, colours) in zip(axes, panels):
            ax.grid(False)
            span = float(field.max() - field.min())
            levels = np.linspace(field.min(), field.max() if span > 1e-9 else field.min() + 1e-6, 15)
            filled = ax.contourf(surface.x_values, surface.y_values, field, levels=levels, cmap=colours)
            bar = figure.colorbar(filled, ax=ax, location="bottom", shrink=0.9, aspect=32, pad=0.03)
            bar.set_label(f"{title} ({unit})" if unit else title)
            bar.locator = MaxNLocator(6)
            bar.update_ticks()
            for ok, style in (
                (True, {"marker": "o", "s": 22, "c": "white", "edgecolors": BLACK, "linewidths": 0.7}),
                (False, {"marker": "x", "s": 34, "c": PURPLE, "linewidths": 1.8}),
            ):
                own = [t for t in done if (facts.outcome(t) is not None) == ok]
                name = "missions" if ok else "failed"
                if own:
                    ax.scatter(
                        [t.values[x] for t in own],
                        [t.values[y] for t in own],
                        label=name,
                        zorder=3,
                        clip_on=False,
                        **style,
                    )
            ax.plot(
                facts.default[x],
                facts.default[y],
                "D",
                ms=9,
                mfc=ORANGE,
                mec=BLACK,
                mew=1.1,
                ls="none",
                label="default",
                zorder=4,
            )
            ax.plot(
                facts.recommendation.values[x],
                facts.recommendation.values[y],
                "*",
                ms=17,
                mfc=VERMILION,
                mec="white",
                mew=1.1,
                ls="none",
                label="recommended",
                zorder=5,
            )
            _scale_axis(ax, surface.x, "x")
            _scale_axis(ax, surface.y, "y")
            ax.set_xlabel(parameter_label(x).axis)
        axes[0].set_ylabel(parameter_label(y).axis)
        handles, names = axes[0].get_legend_handles_labels()
        figure.legend(handles, names, loc="outside upper center", ncols=len(names), markerscale=0.8)
        return figure


def calibration_figure(facts: CampaignFacts) -> Figure:
    """Leave-one-out prediction of every mission against what it measured."""
    observed, predicted, sd, flown = facts.leave_one_out()
    with look():
        figure = new_figure(6.6, 4.4)
        ax = figure.subplots()
        inside = np.abs(observed - predicted) <= NORMAL_95 * sd
        lows = np.concatenate([observed, predicted - NORMAL_95 * sd])
        highs = np.concatenate([observed, predicted + NORMAL_95 * sd])
        ends = [float(lows.min()), float(highs.max())]
        ax.plot(ends, ends, color=GREY, lw=1, ls="--", zorder=1)
        for i, world in enumerate(facts.settings.worlds):
            own = np.array([other == world for other in flown])
            if own.any():
                ax.errorbar(
                    observed[own],
                    predicted[own],
                    NORMAL_95 * sd[own],
                    fmt=marker(i),
                    color=colour(i),
                    ms=5,
                    mec="white",
                    mew=0.4,
                    elinewidth=0.8,
                    label=facts.world_name(world),
                )
        if (~inside).any():
            ax.plot(
                observed[~inside],
                predicted[~inside],
                "o",
                ms=12,
                mfc="none",
                mec=BLACK,
                mew=1.1,
                ls="none",
                label="outside its interval",
            )
        ax.set_xlabel(f"measured: {facts.label.axis}")
        ax.set_ylabel(textwrap.fill(f"predicted without it, 95 % ({facts.label.unit or 'metric'})", 40))
        ax.legend(loc="center left", bbox_to_anchor=(1.01, 0.5))
        return figure


def _scale_axis(ax: Axes, parameter: Parameter, axis: str) -> None:
    setter: Any = ax.set_xscale if axis == "x" else ax.set_yscale
    if parameter.scale == "log":
        setter("log")
        target = ax.xaxis if axis == "x" else ax.yaxis
        decades = np.log10(parameter.high / parameter.low)
        subs = (1.0,) if decades > 3 else (1.0, 3.0) if decades > 1 else (1.0, 2.0, 5.0)
        target.set_major_locator(LogLocator(subs=subs))
        target.set_major_formatter(FuncFormatter(lambda v, _: f"{v:g}"))
        target.set_minor_formatter(NullFormatter())
    limits: Any = ax.set_xlim if axis == "x" else ax.set_ylim
    limits(parameter.low, parameter.high)
