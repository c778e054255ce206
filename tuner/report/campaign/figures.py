"""Figures of a campaign's missions. Each takes the facts and returns a matplotlib figure."""

from __future__ import annotations

import textwrap

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from tuner.report.campaign.facts import CampaignFacts
from tuner.report.style import (
    BLACK,
    BLUE,
    LIGHT,
    PURPLE,
    VERMILION,
    colour,
    look,
    marker,
    new_figure,
)
from tuner.surrogate.numerics import NORMAL_95

RECOMMENDED, DEFAULT, FAILED = VERMILION, BLACK, PURPLE


def history_figure(facts: CampaignFacts) -> Figure:
    """Objective per mission by rock; failed missions as crosses below, the initial design shaded."""
    with look():
        figure = new_figure(9.2, 3.9)
        ax = figure.subplots()
        done = [t for t in facts.trials if t.state != "running"]
        initial = [
            t.number for t in done if t.why.get("phase") in ("default", "earlier missions", "initial design")
        ]
        if initial:
            ax.axvspan(0.5, max(initial) + 1.5, color=LIGHT, zorder=0, label="initial design")
        best = facts.recommendation
        for i, world in enumerate(facts.settings.worlds):
            own = [(t.number + 1, t.raw) for t in done if t.world == world and t.raw is not None]
            ax.plot(
                *(zip(*own) if own else ([], [])),
                marker(i),
                color=colour(i),
                ms=5.5,
                mec="white",
                mew=0.4,
                ls="none",
                label=facts.world_name(world),
            )
        if best is not None:
            own = [(t.number + 1, t.raw) for t in done if t.raw is not None and t.values == best.values]
            ax.plot(
                *(zip(*own) if own else ([], [])),
                "o",
                ms=11,
                mfc="none",
                mec=BLACK,
                mew=1.2,
                ls="none",
                label="recommended configuration",
            )
        failed = [t.number + 1 for t in done if t.raw is None]
        if failed:
            ax.plot(
                failed,
                np.full(len(failed), 0.035),
                "x",
                color=FAILED,
                ms=6.5,
                mew=1.8,
                ls="none",
                transform=ax.get_xaxis_transform(),
                label=f"failed ({len(failed)})",
                clip_on=False,
            )
            ax.margins(y=0.12)
        if len(failed) == len(done):
            ax.set_yticks([])
        ax.set_xlim(0.5, max(1, len(facts.trials)) + 0.5)
        ax.xaxis.set_major_locator(MaxNLocator(integer=True, min_n_ticks=1))
        ax.set_xlabel("mission (trial number)")
        ax.set_ylabel(wrap(facts.label.axis))
        columns = 1 if len(facts.settings.worlds) < 12 else 2
        ax.legend(loc="center left", bbox_to_anchor=(1.005, 0.5), ncols=columns, borderaxespad=0.2)
        return figure


def running_recommendation_figure(facts: CampaignFacts) -> Figure:
    """Posterior mean of the recommended configuration as missions came in."""
    with look():
        figure = new_figure(9.2, 3.6)
        ax = figure.subplots()
        points = facts.checkpoints
        x = np.array([c.missions for c in points])
        mean, sd = np.array([c.mean for c in points]), np.array([c.sd for c in points])
        ax.errorbar(
            x,
            mean,
            NORMAL_95 * sd,
            fmt="o",
            color=BLUE,
            ms=5,
            capsize=3,
            lw=1.2,
            label="as believed at the time, 95 %",
        )
        ax.plot(
            x,
            [c.final_mean for c in points],
            "-s",
            color=VERMILION,
            ms=5,
            mec="white",
            mew=0.5,
            lw=1.4,
            label="the same configuration in the light of all missions",
        )
        assert facts.recommendation is not None
        ax.axhline(
            facts.recommendation.default_mean,
            color=DEFAULT,
            ls="--",
            lw=1.2,
            label=f"{facts.default_name} in the light of all missions",
        )
        ax.xaxis.set_major_locator(MaxNLocator(integer=True, min_n_ticks=1))
        ax.set_xlabel("finished missions")
        ax.set_ylabel(wrap(f"{facts.label.axis}, mean over rocks", 26))
        figure.legend(*ax.get_legend_handles_labels(), loc="outside lower center", ncols=3)
        return figure


def time_figure(facts: CampaignFacts) -> Figure | None:
    """Where the compute time went, by stage; None where missions recorded none."""
    totals: dict[str, float] = {}
    for trial in facts.trials:
        for stage, value in trial.timings_s.items():
            if "." not in stage and stage != "total" and isinstance(value, (int, float)):
                totals[stage] = totals.get(stage, 0.0) + float(value)
    totals = {stage: value for stage, value in totals.items() if value > 0}
    if not totals:
        return None
    with look():
        ordered = sorted(totals.items(), key=lambda item: item[1])
        longest = ordered[-1][1]
        unit, size = ("h", 3600.0) if longest > 7200 else ("min", 60.0) if longest > 120 else ("s", 1.0)
        figure = new_figure(7.6, 0.32 * len(ordered) + 0.9)
        ax = figure.subplots()
        ax.barh(range(len(ordered)), [value / size for _, value in ordered], color=BLUE, height=0.62)
        ax.set_yticks(range(len(ordered)), [stage for stage, _ in ordered])
        whole = sum(totals.values())
        for row, (_, value) in enumerate(ordered):
            ax.annotate(
                f"{100 * value / whole:.0f} %",
                (value / size, row),
                (5, 0),
                textcoords="offset points",
                va="center",
                fontsize=8.5,
            )
        ax.grid(False, axis="y")
        ax.set_xlim(0, 1.12 * longest / size)
        ax.set_xlabel(f"wall-clock time over all missions ({unit})")
        return figure


def wrap(text: str, width: int = 30) -> str:
    """``text`` in lines of at most ``width`` characters, for the label of an axis."""
    return "\n".join(textwrap.wrap(text, width))
