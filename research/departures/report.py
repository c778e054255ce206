"""Tables and the figure of a study of departures."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from rich.table import Table

from nbv.mission.result import json_ready
from nbv.mission.run_directory import write_atomic
from research.departures.study import (
    METRICS,
    ArmResult,
    BaseResult,
    DepartureFindings,
    DepartureSettings,
)
from research.paired_cells import (
    EXACTLY_ZERO,
    difference_text,
    heading,
    interval_sentence,
    markdown_table,
    mean_text,
)
from research.study_directory import preamble
from tuner.evaluation.baselines import label as strategy_label
from tuner.evaluation.comparison import Interval, PairedDifference
from tuner.report.labels import format_number
from tuner.report.style import BLUE, GREY, VERMILION, look, new_figure

_SHOWN = ("f_score_48mm", "c2c_mean_mm")  # of the figure, beside the views


def write_departures_report(findings: DepartureFindings, directory: Path) -> list[Path]:
    """``departures.json``, ``departures.md`` and ``figures/departures.png``; returns the figures' paths."""
    write_atomic(directory / "departures.json", json.dumps(json_ready(findings.to_dict()), indent=1))
    write_atomic(directory / "departures.md", departures_markdown(findings))
    if not any(arm.pairs and not arm.departure.surface for arm in findings.arms):
        return []
    path = directory / "figures" / "departures.png"
    path.parent.mkdir(exist_ok=True)
    figure = departures_figure(findings)
    with look():
        figure.savefig(path, dpi=160, metadata={"Software": None})
    return [path]


def departures_markdown(findings: DepartureFindings) -> str:
    """The base's means, then every departure's paired differences."""
    s = findings.settings
    lines = [
        "# What each departure does to the outcome",
        "",
        *preamble(findings),
    ]
    header = ["base", *(heading(row) for row in METRICS), "B-aware flown (%)", "missions"]
    lines += [*markdown_table(header, [_base_row(b) for b in findings.bases]), ""]
    lines += [
        "One departure alone against the base on the same (rock, replicate): mean difference [95 % interval], bold "
        "where the interval excludes zero. *0 exactly*: no mission differs from the base's by a single bit. *Other "
        "views*: Jaccard distance between the viewpoints that both chose (0 the same, 100 none in common). *Same "
        "flight*: pairs with the same viewpoints in the same order. "
        + interval_sentence(
            [d.interval for a in findings.arms for d in a.differences.values() if d is not None]
        ),
        "",
    ]
    header = [
        "departure",
        "by",
        *(heading(row, difference=True) for row in METRICS),
        "B-aware flown (points)",
        "other views (%)",
        "same flight",
    ]
    lines += markdown_table(header, [_arm_row(a, s) for a in findings.arms], left=2)
    if s.as_base:
        lines += ["", "Not flown, because the base is that way already:", ""]
        lines += [f"- {d.what} (`{d.name}`, {d.origin})" for d in s.as_base]
    if findings.arms:
        lines += ["", "![departures](figures/departures.png)"]
    return "\n".join(lines) + "\n"


def _base_row(base: BaseResult) -> list[str]:
    cells = [mean_text(base.cells[row.key], row.decimals) for row in METRICS]
    name = strategy_label(base.strategy.removeprefix("base-"))
    return [name, *cells, mean_text(base.b_aware, 0), str(base.missions)]


def _arm_row(arm: ArmResult, settings: DepartureSettings) -> list[str]:
    d = arm.departure
    gate = f" (against {strategy_label(d.gate)})" if d.gate and d.gate != settings.gate else ""
    cells = [difference_text(arm.differences[row.key], row.decimals) for row in METRICS]
    flight = f"{arm.same_flights} of {arm.pairs}" + (f", {arm.failed} failed" if arm.failed else "")
    return [
        f"{d.what}{gate}",
        d.origin,
        *cells,
        difference_text(arm.b_aware, 0),
        _views_text(arm.other_views),
        flight,
    ]


def _views_text(views: Interval | None) -> str:
    if views is not None and views.mean == 0:
        return EXACTLY_ZERO
    return mean_text(views, 0)


def departures_table(findings: DepartureFindings) -> Table:
    """The arms for the terminal: F-score, mean C2C, views."""
    shown = [row for row in METRICS if row.key in (*_SHOWN, "hausdorff_gt_to_cloud_mm")]
    table = Table(
        title="Difference from the base, paired", caption="95 % interval; 0 exactly: not a bit differs"
    )
    table.add_column("departure", no_wrap=True)
    for row in shown:
        table.add_column(heading(row, difference=True), justify="right")
    table.add_column("other views (%)", justify="right")
    table.add_column("same flight", justify="right")
    for arm in findings.arms:
        cells = [difference_text(arm.differences[row.key], row.decimals, bold=False) for row in shown]
        views = _views_text(arm.other_views)
        table.add_row(arm.departure.name, *cells, views, f"{arm.same_flights} of {arm.pairs}")
    return table


def departures_figure(findings: DepartureFindings) -> Figure:
    """Differences with intervals beside the share of other views, one line per departure.

    Another surface is another quantity, points away from the rest: it is in the table only.
    """
    arms = [arm for arm in findings.arms if arm.pairs and not arm.departure.surface]
    with look():
        figure = new_figure(9.6, 0.34 * len(arms) + 1.5)
        axes = figure.subplots(1, 3, sharey=True)
        for ax, key in zip(axes, _SHOWN):
            row = next(r for r in METRICS if r.key == key)
            _difference_panel(ax, [arm.differences[key] for arm in arms])
            unit = "points" if row.unit == "%" else row.unit
            ax.set_xlabel(
                f"{row.label}, minus base ({unit})\n{'right' if row.higher_is_better else 'left'} is better"
            )
        shares = [arm.other_views.mean if arm.other_views else np.nan for arm in arms]
        axes[2].barh(range(len(arms)), shares, color=BLUE, height=0.6)
        for y, share in enumerate(shares):
            axes[2].text(share + 1.5, y, format_number(share, 0), va="center", fontsize=8, color=GREY)
        axes[2].set_xlim(0, max(25.0, 1.18 * float(np.nanmax(shares))))
        axes[2].set_xlabel("views that the base did not choose,\nJaccard distance (%)")
        axes[0].set_yticks(range(len(arms)), [arm.departure.name for arm in arms])
        axes[0].set_ylim(len(arms) - 0.4, -0.6)
        for ax in axes:
            ax.grid(False, axis="y")
        handles = [
            Line2D([], [], color=BLUE, marker="o", label="mean, 95 % interval"),
            Line2D([], [], color=VERMILION, marker="s", label="interval excludes zero"),
            Line2D([], [], color=GREY, marker="|", ls="none", ms=9, label="0 exactly"),
        ]
        figure.legend(handles=handles, loc="outside upper center", ncols=3)
        return figure


def _difference_panel(ax: Axes, differences: Sequence[PairedDifference | None]) -> None:
    ax.axvline(0, color=GREY, lw=0.8)
    for y, d in enumerate(differences):
        if d is None:
            continue
        if d.exactly_zero:
            ax.plot(0, y, "|", color=GREY, ms=9, mew=2)
            continue
        i = d.interval
        shade, form = (VERMILION, "s") if i.excludes_zero else (BLUE, "o")
        if i.low is not None and i.high is not None:
            ax.plot([i.low, i.high], [y, y], color=shade, lw=1.5)
        ax.plot(i.mean, y, form, color=shade, ms=5)
