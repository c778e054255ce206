"""Every mission of a comparison, rock by rock."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from tuner.evaluation.baselines import label as strategy_label
from tuner.evaluation.paper_table import MetricRow
from tuner.missions.job import Trial
from tuner.problem.worlds import World, rocks_of
from tuner.report.labels import metric_label
from tuner.report.style import colour, look, marker, new_figure, short_names


def rocks_figure(
    records: Sequence[Trial], strategies: Sequence[str], worlds: Sequence[World], metric: MetricRow
) -> Figure:
    """Every successful mission of every strategy, world by world; bars are means.

    Parameters
    ----------
    records
        The missions.
    strategies
        In the order of their markers.
    worlds
        From left to right.
    metric
        What is shown.
    """
    with look():
        figure = new_figure(9.6, 3.7)
        ax = figure.subplots()
        width = 0.8 / len(strategies)
        for s, name in enumerate(strategies):
            for w, world in enumerate(worlds):
                x = w - 0.4 + width * (s + 0.5)
                own = [r.value(metric.key) for r in records if r.strategy == name and r.world == world]
                values = [value for value in own if value is not None]
                if not values:
                    continue
                spread = np.linspace(-0.22, 0.22, len(values)) * width if len(values) > 1 else [0.0]
                ax.plot(
                    x + np.array(spread), values, marker(s), color=colour(s), ms=4, alpha=0.55, mec="none"
                )
                ax.hlines(np.mean(values), x - 0.42 * width, x + 0.42 * width, color=colour(s), lw=2.4)
        for w in range(1, len(worlds)):
            ax.axvline(w - 0.5, color="#cfcfcf", lw=0.8)
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
        ax.set_ylabel(metric_label(metric.key).axis)
        handles = [
            Line2D([], [], color=colour(s), marker=marker(s), lw=2.4, ms=4.5, label=strategy_label(name))
            for s, name in enumerate(strategies)
        ]
        figure.legend(handles=handles, loc="outside upper center", ncols=min(len(handles), 7))
        return figure
