"""Figures of what a campaign's model says. Each takes the facts and returns a matplotlib figure."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullFormatter

from tuner.problem.search_space import Parameter
from tuner.report.campaign.facts import CampaignFacts, Slice
from tuner.report.campaign.figures import DEFAULT, FAILED, RECOMMENDED, wrap
from tuner.report.labels import parameter_label
from tuner.report.style import (
    BLACK,
    BLUE,
    GREEN,
    GREY,
    ORANGE,
    SEQUENTIAL,
    SKY,
    VERMILION,
    colour,
    look,
    marker,
    new_figure,
)
from tuner.surrogate.numerics import NORMAL_95


def slices_figure(facts: CampaignFacts) -> Figure:
    """One panel per parameter: posterior mean with its 95 % band through the recommendation."""
    with look():
        slices = facts.slices
        columns = min(len(slices), 3 if len(slices) != 4 else 2)
        rows = -(-len(slices) // columns)
        width = 9.2 if columns > 1 else 5.4
        figure = new_figure(width, 2.75 * rows + 0.55)
        figure.get_layout_engine().set(wspace=0.06, hspace=0.06)  # type: ignore[union-attr,call-arg]
        axes = np.atleast_1d(figure.subplots(rows, columns, sharey=True, squeeze=False)).ravel()
        for i, (ax, part) in enumerate(zip(axes, slices)):
            _slice_panel(ax, facts, part)
            if i % columns == 0:
                ax.set_ylabel(wrap(facts.label.axis, 24))
        for ax in axes[len(slices) :]:
            ax.set_visible(False)
        handles = [
            Line2D([], [], color=BLUE, lw=1.8, label="posterior mean, 95 % band"),
            Line2D(
                [],
                [],
                color=GREY,
                marker="o",
                ls="none",
                ms=4.5,
                label="missions (faint: far from the slice)",
            ),
            Line2D([], [], color=RECOMMENDED, lw=1.5, label="recommended"),
            Line2D([], [], color=DEFAULT, lw=1.2, ls="--", label=facts.default_name),
        ]
        figure.legend(handles=handles, loc="outside lower center", ncols=4 if columns > 1 else 2)
        return figure


def _slice_panel(ax: Axes, facts: CampaignFacts, part: Slice) -> None:
    assert facts.recommendation is not None and facts.model is not None
    p, path = part.parameter, part.parameter.path
    observed = [o.values[path] for o in facts.model.observations]
    alpha = 0.12 + 0.78 * facts.closeness([path])
    shades = np.array([[*(int(GREY[k : k + 2], 16) / 255 for k in (1, 3, 5)), a] for a in alpha])
    low, high = part.mean - NORMAL_95 * part.sd, part.mean + NORMAL_95 * part.sd
    if p.kind == "categorical":
        x = np.arange(len(part.positions))
        jitter = 0.08 * (np.arange(len(observed)) % 5 - 2)
        ax.scatter([p.choices.index(v) for v in observed] + jitter, facts.adjusted, s=16, c=shades, lw=0)
        ax.errorbar(x, part.mean, NORMAL_95 * part.sd, fmt="D", color=BLUE, ms=5, capsize=5, lw=1.8)
        for value, style in ((facts.default[path], "--"), (facts.recommendation.values[path], "-")):
            ax.axvline(
                p.choices.index(value),
                color=DEFAULT if style == "--" else RECOMMENDED,
                ls=style,
                lw=1.2,
                zorder=1,
                alpha=0.6,
            )
        ax.set_xticks(x, [str(choice) for choice in p.choices])
        ax.set_xlim(-0.5, len(x) - 0.5)
    else:
        ax.fill_between(part.positions, low, high, color=SKY, alpha=0.35, lw=0)
        ax.plot(part.positions, part.mean, color=BLUE, lw=1.8, marker="o" if p.kind == "int" else "", ms=3.5)
        ax.scatter(observed, facts.adjusted, s=16, c=shades, lw=0, zorder=3, clip_on=False)
        ax.axvline(facts.default[path], color=DEFAULT, ls="--", lw=1.2)
        ax.axvline(facts.recommendation.values[path], color=RECOMMENDED, lw=1.5, clip_on=False)
        _scale_axis(ax, p, "x")
    ax.set_xlabel(parameter_label(path).axis)


def map_figure(facts: CampaignFacts) -> Figure | None:
    """Posterior mean and standard deviation over two parameters; None where fewer than two are ordered."""
    surface = facts.surface()
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
                (False, {"marker": "x", "s": 34, "c": FAILED, "linewidths": 1.8}),
            ):
                own = [t for t in done if (t.raw is not None) == ok]
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
                label=facts.default_name,
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
        ax.set_ylabel(wrap(f"predicted without it, 95 % ({facts.label.unit or 'metric'})", 40))
        ax.legend(loc="center left", bbox_to_anchor=(1.01, 0.5))
        return figure


def relevance_figure(facts: CampaignFacts) -> Figure:
    """How much the posterior mean moves along each parameter, with its length scale."""
    assert facts.model is not None
    with look():
        slices = sorted(facts.slices, key=lambda s: s.effect)
        figure = new_figure(7.6, 0.36 * len(slices) + 1.0)
        ax = figure.subplots()
        effect = [s.effect for s in slices]
        names = [parameter_label(s.parameter.path).name for s in slices]
        ax.barh(range(len(slices)), effect, color=GREEN, height=0.62)
        ax.set_yticks(range(len(slices)), names)
        ax.grid(False, axis="y")
        top = max([*effect, 1e-12])
        for row, part in enumerate(slices):
            length = facts.model.lengthscales.get(part.parameter.path)
            note = "categorical" if length is None else f"ℓ = {length:.2f}"
            ax.annotate(
                note, (part.effect, row), (5, 0), textcoords="offset points", va="center", fontsize=8.5
            )
        ax.set_xlim(0, 1.18 * top)
        unit = f" ({facts.label.difference_unit})" if facts.label.difference_unit else ""
        ax.set_xlabel(f"range of the posterior mean along the slice{unit}")
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
