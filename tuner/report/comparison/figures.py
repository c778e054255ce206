"""Figures of a comparison: forest plots of paired differences, rock by rock, sector by sector."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from tuner.evaluation.baselines import label as strategy_label
from tuner.evaluation.comparison import ComparisonTable
from tuner.evaluation.paper_table import MetricRow
from tuner.missions.job import Trial
from tuner.problem.worlds import World, rocks_of
from tuner.report.comparison.tables import difference_verdict, gain_interval
from tuner.report.labels import metric_label
from tuner.report.style import (
    BLUE,
    GREY,
    PURPLE,
    VERMILION,
    colour,
    look,
    marker,
    new_figure,
    short_names,
)

VERDICT_COLOURS = {
    "better": BLUE,
    "worse": VERMILION,
    "no difference detected": GREY,
    "no interval": "#b9b9b9",
}


def forest_figure(table: ComparisonTable) -> Figure | None:
    """Paired improvement over the reference per metric and strategy; right of zero is better."""
    others = [name for name in table.strategies if name != table.reference]
    if table.reference is None or not others:
        return None
    with look():
        columns = min(4, len(table.rows))
        rows = -(-len(table.rows) // columns)
        figure = new_figure(9.6, rows * (0.27 * len(others) + 1.15) + 0.4)
        figure.get_layout_engine().set(hspace=0.1)  # type: ignore[union-attr,call-arg]
        axes = figure.subplots(rows, columns, sharey=True, squeeze=False)
        for ax, row in zip(axes.ravel(), table.rows):
            ax.axvline(0, color="#222222", lw=1)
            for y, name in enumerate(reversed(others)):
                difference = row.differences[name]
                if difference is None:
                    continue
                gain, low, high = gain_interval(difference, row.metric)
                shade = VERDICT_COLOURS[difference_verdict(difference, row.metric)]
                if low is not None and high is not None:
                    ax.plot([low, high], [y, y], color=shade, lw=2, solid_capstyle="butt")
                ax.plot(gain, y, "o", color=shade, ms=5.5, mec="white", mew=0.5)
            ax.set_ylim(-0.6, len(others) - 0.4)
            ax.set_yticks(range(len(others)), [strategy_label(name) for name in reversed(others)])
            ax.grid(False, axis="y")
            unit = "points" if row.metric.unit == "%" else row.metric.unit
            ax.set_title(_short_title(row.metric))
            ax.set_xlabel(f"improvement ({unit})" if unit else "improvement")
            ax.locator_params(axis="x", nbins=4)
        for ax in axes.ravel()[len(table.rows) :]:
            ax.set_visible(False)
        handles = [
            Line2D([], [], color=shade, marker="o", lw=2, ms=5, label=name)
            for name, shade in VERDICT_COLOURS.items()
            if name != "no interval"
        ]
        figure.legend(handles=handles, loc="outside lower center", ncols=3)
        return figure


def _short_title(metric: MetricRow) -> str:
    return metric_label(metric.key).name.replace(" distance", "")


def rocks_figure(
    records: Sequence[Trial], strategies: Sequence[str], worlds: Sequence[World], metric: MetricRow
) -> Figure:
    """Every mission of every strategy, world by world; bars are means, crosses at the bottom failed missions."""
    with look():
        figure = new_figure(9.6, 3.7)
        ax = figure.subplots()
        width = 0.8 / len(strategies)
        for s, name in enumerate(strategies):
            for r, world in enumerate(worlds):
                x = r - 0.4 + width * (s + 0.5)
                own = [record for record in records if record.strategy == name and record.world == world]
                values = [v for record in own if (v := record.value(metric.key)) is not None]
                spread = (
                    np.linspace(-0.22, 0.22, len(values)) * width
                    if len(values) > 1
                    else np.zeros(len(values))
                )
                ax.plot(
                    x + spread, values, marker(s), color=colour(s), ms=4, alpha=0.55, mec="none", ls="none"
                )
                if values:
                    ax.plot(
                        [x - 0.42 * width, x + 0.42 * width], [np.mean(values)] * 2, color=colour(s), lw=2.4
                    )
                failed = sum(record.value(metric.key) is None for record in own)
                if failed:
                    ax.plot(
                        x,
                        0.03,
                        "x",
                        color=PURPLE,
                        ms=6,
                        mew=1.8,
                        transform=ax.get_xaxis_transform(),
                        clip_on=False,
                    )
                    ax.annotate(
                        str(failed),
                        (x, 0.03),
                        (4, 2),
                        xycoords=ax.get_xaxis_transform(),
                        textcoords="offset points",
                        fontsize=7.5,
                        color=PURPLE,
                    )
        for r in range(1, len(worlds)):
            ax.axvline(r - 0.5, color="#cfcfcf", lw=0.8)
        rocks = dict(zip(rocks_of(worlds), short_names(list(rocks_of(worlds)))))
        names = [World(rocks[world.rock], world.condition).label for world in worlds]
        slanted = sum(map(len, names)) > 90
        ax.set_xticks(
            range(len(worlds)), names, rotation=25 if slanted else 0, ha="right" if slanted else "center"
        )
        ax.tick_params(axis="x", length=0)
        ax.grid(False, axis="x")
        ax.margins(y=0.12)
        ax.set_xlim(-0.5, len(worlds) - 0.5)
        ax.set_ylabel(f"{_short_title(metric)}{f' ({metric.unit})' if metric.unit else ''}")
        handles = [
            Line2D([], [], color=colour(s), marker=marker(s), lw=2.4, ms=4.5, label=strategy_label(name))
            for s, name in enumerate(strategies)
        ]
        figure.legend(handles=handles, loc="outside upper center", ncols=min(len(handles), 7))
        return figure
