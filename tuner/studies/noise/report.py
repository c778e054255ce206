"""Tables and figures of a noise study."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.image import AxesImage
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Rectangle
from rich.table import Table

from nbv.mission.result import json_ready
from nbv.mission.run_directory import write_atomic
from tuner.report.labels import MISSING, format_number, metric_label, strategy_label
from tuner.report.style import (
    BLACK,
    BLUE,
    GREEN,
    GREY,
    ORANGE,
    PURPLE,
    SEQUENTIAL,
    SKY,
    VERMILION,
    look,
    new_figure,
    save_figure,
)
from tuner.studies.noise.study import DEFAULT, TARGET_SIGNAL_TO_NOISE, NoiseCell, NoiseFindings

_SHARE_LOOK = {  # colour and hatch: the hatch tells them apart in grey
    "configuration": (BLUE, ""),
    "configuration x rock": (SKY, "//"),
    "rock": ("#d9d9d9", ""),
    "replicate": (ORANGE, "\\\\"),
    "residual": (VERMILION, ".."),
}
_REFERENCES = {
    DEFAULT: (BLACK, "-"),
    "learned": (PURPLE, ":"),
    "random": (ORANGE, "--"),
    "greedy-oracle": (GREEN, "-."),
}


def write_noise_report(findings: NoiseFindings, directory: Path) -> list[Path]:
    """``noise.json``, ``noise.md`` and ``figures/*.png``; returns the figures' paths."""
    write_atomic(directory / "noise.json", json.dumps(json_ready(findings.to_dict()), indent=1))
    figures = {"signal_to_noise": signal_to_noise_figure(findings)}
    for metric in findings.settings.metrics:
        if findings.ranked(metric):
            figures[f"configurations_{metric}"] = configurations_figure(findings, metric)
            figures[f"variance_{metric}"] = variance_figure(findings, metric)
    folder = directory / "figures"
    folder.mkdir(exist_ok=True)
    written = [save_figure(figure, folder, name) for name, figure in figures.items()]
    write_atomic(directory / "noise.md", noise_markdown(findings))
    return written


# -- tables --------------------------------------------------------------------------------------------------

_COLUMNS = {  # terminal: file
    "captures": "budget",
    "agree": "agreeing views",
    "S/N": "signal to noise",
    "95 %": "95 %",
    "paired": "paired",
    "unseen": "unseen rocks",
    "sd conf.": "sd between configurations",
    "sd repl.": "sd of a rock mean (1 replicate)",
    "default": "default",
    "learned": "learned gate",
    "random": "random",
    "ceiling": "greedy oracle",
    "best": "best of the design",
    "s": "s per mission",
    "missing": "missing",
}


def _row(cell: NoiseCell, metric: str) -> list[str]:
    label = metric_label(metric)
    c = cell.components
    head = [str(cell.budget), str(cell.agreement)]
    if c is None:
        return [*head, *[MISSING] * (len(_COLUMNS) - 3), str(cell.missing)]
    low, high = c.signal_to_noise_interval()
    designed = [m for name, m in cell.means.items() if name.startswith("sobol-")]
    best = (max if label.larger_is_better else min)(designed)
    return [
        *head,
        format_number(c.signal_to_noise),
        f"{format_number(low)} to {format_number(high)}",
        format_number(c.paired_signal_to_noise),
        format_number(c.unseen_signal_to_noise),
        format_number(math.sqrt(max(0.0, c.between)), 2),
        format_number(math.sqrt(c.noise), 2),
        *(format_number(cell.means.get(name)) for name in (DEFAULT, "learned", "random", "greedy-oracle")),
        format_number(best),
        format_number(cell.mission_s, 0),
        str(cell.missing),
    ]


def noise_table(findings: NoiseFindings, metric: str) -> Table:
    """One metric's cells for the terminal, best signal to noise first."""
    table = Table(title=metric_label(metric).full)
    for column in _COLUMNS:
        table.add_column(column, justify="right")
    for cell in findings.ranked(metric):
        table.add_row(*_row(cell, metric), style="bold" if cell.meets_target else "")
    return table


def noise_markdown(findings: NoiseFindings) -> str:
    """The same tables for ``noise.md``, with what was flown and what the columns mean."""
    s = findings.settings
    lines = [
        "# Noise study",
        "",
        f"{s.configurations} Sobol points of search space `{s.space.name}`, the default and "
        f"{', '.join(s.controls) or 'no controls'}, on {len(s.rocks)} rocks ({', '.join(s.rocks)}), "
        f"{s.replicates} replicates each; {s.repeats} further replicates of the default. "
        f"Preset `{s.preset}`{', ' + str(s.overrides) if s.overrides else ''}; adaptive budgets "
        f"{', '.join(map(str, s.budgets))}. "
        f"{len(findings.records)} of {findings.expected} missions are in.",
        "",
        "Signal to noise is the variance between the design's configurations (of their true mean over these rocks) over the "
        "replicate variance of one configuration's mean over the rocks, one replicate per rock. *Paired* compares on "
        "common replicates, where draws that all configurations share cancel. *Unseen rocks* counts only differences "
        "between configurations that do not depend on the rock. The interval is for the first figure, from the F "
        f"distribution. Wanted: at least {TARGET_SIGNAL_TO_NOISE:g} (bold). *Missing* counts the design's missions "
        "without the metric; configurations with a hole are left out.",
    ]
    if findings.failures:
        counts = ", ".join(f"{reason} {n}" for reason, n in sorted(findings.failures.items()))
        lines += ["", f"Failed missions by reason: {counts}."]
    for metric in s.metrics:
        label = metric_label(metric)
        lines += ["", f"## {label.full} ({label.unit}, {label.arrow})", ""]
        cells = findings.ranked(metric)
        if not cells:
            lines.append("Not enough complete configurations yet.")
            continue
        lines += ["| " + " | ".join(_COLUMNS.values()) + " |", "|" + "---:|" * len(_COLUMNS)]
        for cell in cells:
            row = _row(cell, metric)
            if cell.meets_target:
                row[2] = f"**{row[2]}**"
            lines.append("| " + " | ".join(row) + " |")
        lines += ["", f"![configurations](figures/configurations_{metric}.png)"]
        lines += ["", f"![variance](figures/variance_{metric}.png)"]
    lines += ["", "## Replicates of the default configuration", ""]
    lines += [
        "| metric | budget | agreeing views | sd within a rock | 95 % | degrees of freedom |",
        "|---|---:|---:|---:|---:|---:|",
    ]
    for cell in findings.cells:
        if cell.default_within is not None:
            variance, low, high, degrees = cell.default_within
            lines.append(
                f"| {cell.metric} | {cell.budget} | {cell.agreement} | {format_number(math.sqrt(variance), 2)} | "
                f"{format_number(math.sqrt(low), 2)} to {format_number(math.sqrt(high), 2)} | {degrees} |"
            )
    return "\n".join(lines) + "\n"


# -- figures -------------------------------------------------------------------------------------------------


def signal_to_noise_figure(findings: NoiseFindings) -> Figure:
    """One map per metric: budgets across, strictness up; cells that meet the target are framed."""
    settings = findings.settings
    with look():
        columns = min(4, len(settings.metrics))
        rows = -(-len(settings.metrics) // columns)
        width = max(4.6, 2.6 * columns + 0.8)
        figure = new_figure(width, 2.5 * rows + 0.5)
        axes = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
        image = None
        for ax, metric in zip(axes.ravel(), settings.metrics):
            image = _map_panel(ax, findings, metric)
        for ax in axes.ravel()[len(settings.metrics) :]:
            ax.set_visible(False)
        for ax in axes[:, 0]:
            ax.set_ylabel("agreeing views")
        for ax in axes[-1]:
            ax.set_xlabel("adaptive captures")
        if image is not None:
            bar = figure.colorbar(image, ax=axes, shrink=0.8, extend="max")
            bar.set_label(f"signal to noise (framed: {TARGET_SIGNAL_TO_NOISE:g} or more)")
        return figure


def _map_panel(ax: Axes, findings: NoiseFindings, metric: str) -> AxesImage:
    budgets, levels = sorted(findings.settings.budgets), sorted(findings.settings.levels)
    grid = np.full((len(levels), len(budgets)), np.nan)
    for i, level in enumerate(levels):
        for j, budget in enumerate(budgets):
            if (c := findings.cell(budget, level, metric).components) is not None:
                grid[i, j] = c.signal_to_noise
    top = 2 * TARGET_SIGNAL_TO_NOISE
    image = ax.imshow(np.minimum(grid, top), cmap=SEQUENTIAL, vmin=0, vmax=top, origin="lower", aspect="auto")
    for (i, j), value in np.ndenumerate(grid):
        text = MISSING if math.isnan(value) else f"{value:.1f}"
        ax.text(
            j,
            i,
            text,
            ha="center",
            va="center",
            color="black" if value > 0.6 * top else "white" if value == value else GREY,
        )
        if value >= TARGET_SIGNAL_TO_NOISE:
            ax.add_patch(Rectangle((j - 0.46, i - 0.46), 0.92, 0.92, fill=False, ec=VERMILION, lw=1.8))
    ax.set_xticks(range(len(budgets)), [str(b) for b in budgets])
    ax.set_yticks(range(len(levels)), [str(level) for level in levels])
    ax.grid(False)
    label = metric_label(metric)
    ax.set_title(f"{label.name},\n{label.surface}" if label.surface else label.name, fontsize=9)
    return image


def configurations_figure(findings: NoiseFindings, metric: str) -> Figure:
    """Per budget, at its best strictness: every configuration's rock mean, its replicates, the references."""
    with look():
        cells = [
            next(c for c in findings.ranked(metric) if c.budget == budget)
            for budget in sorted({c.budget for c in findings.ranked(metric)})
        ]
        columns = min(2, len(cells))
        rows = -(-len(cells) // columns)
        figure = new_figure(4.7 * columns + 0.4, 2.9 * rows + 0.6)
        axes = figure.subplots(rows, columns, squeeze=False)
        for ax, cell in zip(axes.ravel(), cells):
            _configurations_panel(ax, findings, cell)
        for ax in axes.ravel()[len(cells) :]:
            ax.set_visible(False)
        for ax in axes[:, 0]:
            ax.set_ylabel(f"{metric_label(metric).axis}\nmean over rocks")
        handles = [
            Line2D([], [], color=BLUE, marker="o", ls="none", ms=5, label="configuration (Sobol)"),
            Line2D([], [], color=GREY, marker="_", ls="none", ms=7, label="one replicate of all rocks"),
        ]
        handles += [
            Line2D(
                [],
                [],
                color=shade,
                ls=dash,
                label="paper's default" if name == DEFAULT else strategy_label(name),
            )
            for name, (shade, dash) in _REFERENCES.items()
            if any(name in cell.means for cell in cells)
        ]
        figure.legend(handles=handles, loc="outside lower center", ncols=3)
        return figure


def _configurations_panel(ax: Axes, findings: NoiseFindings, cell: NoiseCell) -> None:
    values = findings.values(cell.budget, cell.agreement, cell.metric)
    designed = sorted(
        (name for name in cell.means if name.startswith("sobol-")), key=lambda name: cell.means[name]
    )
    for x, name in enumerate(designed):
        by_replicate = values[name].mean(axis=0)  # (R,) one flight of every rock
        ax.plot([x] * len(by_replicate), by_replicate, "_", color=GREY, ms=7, mew=1.1)
        ax.plot(x, cell.means[name], "o", color=BLUE, ms=5, mec="white", mew=0.5)
    for name, (shade, dash) in _REFERENCES.items():
        if name in cell.means:
            ax.axhline(cell.means[name], color=shade, ls=dash, lw=1.3)
    assert cell.components is not None
    ax.set_title(
        f"{cell.budget} captures, {cell.agreement} agreeing views: "
        f"S/N {format_number(cell.components.signal_to_noise)}"
    )
    ax.set_xticks([])
    ax.set_xlabel(f"{len(designed)} configurations, sorted")
    ax.grid(False, axis="x")


def variance_figure(findings: NoiseFindings, metric: str) -> Figure:
    """Where the variance of a single mission comes from, per budget and strictness."""
    cells = sorted(findings.ranked(metric), key=lambda c: (c.budget, c.agreement))
    with look():
        figure = new_figure(7.6, 0.27 * len(cells) + 1.5)
        ax = figure.subplots()
        left = np.zeros(len(cells))
        for name, (shade, hatch) in _SHARE_LOOK.items():
            width = np.array([100 * c.components.shares()[name] for c in cells if c.components is not None])
            ax.barh(
                range(len(cells)),
                width,
                left=left,
                color=shade,
                hatch=hatch,
                edgecolor="white",
                linewidth=0.6,
                height=0.8,
            )
            left += width
        ax.set_yticks(range(len(cells)), [f"{c.budget} captures, {c.agreement} views" for c in cells])
        ax.set_ylim(len(cells) - 0.4, -0.6)
        ax.set_xlim(0, 100)
        ax.set_xlabel(f"share of the variance of one mission's {metric_label(metric).full} (%)")
        ax.grid(False, axis="y")
        names = {"configuration x rock": "configuration × rock", "replicate": "replicate (shared draw)"}
        handles = [
            Patch(facecolor=shade, hatch=hatch, edgecolor="white", label=names.get(name, name))
            for name, (shade, hatch) in _SHARE_LOOK.items()
        ]
        figure.legend(handles=handles, loc="outside upper center", ncols=5, fontsize=8)
        return figure
