"""Table and figures of a sensitivity analysis."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.patheffects import withStroke
from rich.table import Table

from nbv.mission.result import json_ready
from nbv.mission.run_directory import write_atomic
from tuner.report.labels import format_number, metric_label, parameter_label, parameter_value
from tuner.report.style import BLACK, BLUE, ORANGE, SEQUENTIAL, SKY, VERMILION, look, new_figure, save_figure
from tuner.studies.sensitivity.study import Sensitivity


def write_sensitivity_report(result: Sensitivity, directory: Path) -> list[Path]:
    """``sensitivity.json``, ``sensitivity.md`` and ``figures/*.png``; returns the figures' paths."""
    figures = {"importance": importance_figure(result)}
    if result.interaction is not None:
        figures["interaction"] = interaction_figure(result)
    folder = directory / "figures"
    folder.mkdir(parents=True, exist_ok=True)
    write_atomic(directory / "sensitivity.json", json.dumps(json_ready(result.to_dict()), indent=1))
    written = [save_figure(figure, folder, name) for name, figure in figures.items()]
    write_atomic(directory / "sensitivity.md", sensitivity_markdown(result))
    return written


_COLUMNS = ("parameter", "first order", "95 %", "total", "95 %", "fANOVA", "PED-ANOVA")


def _rows(result: Sensitivity) -> list[list[str]]:
    def span(bounds: tuple[float, float]) -> str:
        return f"{format_number(bounds[0], 2)} to {format_number(bounds[1], 2)}"

    return [
        [
            parameter_label(item.path).name,
            format_number(item.first, 2),
            span(item.first_belief),
            format_number(item.total, 2),
            span(item.total_belief),
            format_number(item.fanova, 2),
            format_number(item.ped_anova, 2),
        ]
        for item in result.importances
    ]


def sensitivity_table(result: Sensitivity) -> Table:
    """For the terminal, most important parameter first."""
    table = Table(title=f"What matters for {metric_label(result.data.objective.metric).full}")
    for i, column in enumerate(_COLUMNS):
        table.add_column(column, justify="right" if i else "left")
    for row in _rows(result):
        table.add_row(*row)
    return table


def summary_lines(result: Sensitivity) -> list[str]:
    """What a reader needs to judge the indices."""
    label = metric_label(result.data.objective.metric)
    lines = [
        f"{len(result.data.observations)} missions on {len(result.data.rocks)} rocks, search space "
        f"{result.data.space.name}; the surrogate explains {100 * result.explained:.0f} % of their variance "
        f"(leave-one-out, per-rock standardised).",
        f"Over the space the surrogate's mean varies with a standard deviation of "
        f"{format_number(result.signal_sd, 2)} {label.difference_unit}; a single mission's noise is "
        f"{format_number(result.noise_sd, 2)} {label.difference_unit}.",
    ]
    if (pair := result.interaction) is not None:
        names = " and ".join(parameter_label(path).name for path in pair.paths)
        low, high = pair.second_belief
        lines.append(
            f"Interaction of {names}: {format_number(pair.second, 2)} of the variance "
            f"({format_number(low, 2)} to {format_number(high, 2)})."
        )
    lines += [f"Left out: {count} missions ({reason})." for reason, count in result.data.left_out.items()]
    if result.caution:
        lines.append(f"Caution: {result.caution}.")
    return lines


def sensitivity_markdown(result: Sensitivity) -> str:
    """The table with what the columns mean."""
    lines = [
        f"# What matters for {metric_label(result.data.objective.metric).full}",
        "",
        *(f"{line}  " for line in summary_lines(result)),
        "",
        "| " + " | ".join(_COLUMNS) + " |",
        "|---|" + "---:|" * (len(_COLUMNS) - 1),
        *("| " + " | ".join(row) + " |" for row in _rows(result)),
        "",
        "Sobol indices of the surrogate's posterior mean: the share of its variance over the search space that a "
        "parameter explains alone (first order) and with all its interactions (total). Intervals: posterior draws "
        "and bootstrap, kernel parameters fixed; a draw varies in more ways than the mean does, so where missions "
        "are few a mean's index may lie outside of its interval. fANOVA and PED-ANOVA are Optuna's, from the missions without the "
        "surrogate; each sums to 1, PED-ANOVA asks what tells the best tenth from the rest. All are relative to "
        "the search space's bounds and scales, and missions of a campaign crowd where it looked.",
        "",
        "![importance](figures/importance.png)",
    ]
    if result.interaction is not None:
        lines += ["", "![interaction](figures/interaction.png)"]
    return "\n".join(lines) + "\n"


def importance_figure(result: Sensitivity) -> Figure:
    """Bars of first-order and total indices with intervals, Optuna's importances as markers."""
    items = result.importances
    with look():
        figure = new_figure(7.8, 0.5 * len(items) + 1.5)
        ax = figure.subplots()
        top = 1.0
        for y, item in enumerate(items):
            bars = (
                (item.total, item.total_belief, -0.19, SKY, ""),
                (item.first, item.first_belief, 0.19, BLUE, "//"),
            )
            for value, (low, high), shift, shade, hatch in bars:
                if not math.isfinite(value):
                    continue
                ax.barh(
                    y + shift,
                    max(0.0, value),
                    height=0.36,
                    color=shade,
                    hatch=hatch,
                    edgecolor="white",
                    linewidth=0.5,
                )
                ax.plot([max(0.0, low), max(0.0, high)], [y + shift] * 2, color=BLACK, lw=1.2)
                top = max(top, high)
            for share, mark, shade in ((item.fanova, "D", VERMILION), (item.ped_anova, "o", ORANGE)):
                if share is not None:
                    ax.plot(share, y, mark, color=shade, ms=6, mec="black", mew=0.6, zorder=4)
        ax.set_yticks(range(len(items)), [parameter_label(item.path).name for item in items])
        ax.set_ylim(len(items) - 0.45, -0.55)
        ax.set_xlim(0.0, 1.02 * top)
        ax.grid(False, axis="y")
        ax.set_xlabel(f"share of the variance of {metric_label(result.data.objective.metric).full}")
        handles: list[Line2D | Patch] = [
            Patch(facecolor=SKY, edgecolor="white", label="Sobol, total"),
            Patch(facecolor=BLUE, hatch="//", edgecolor="white", label="Sobol, alone"),
            Line2D([], [], color=BLACK, lw=1.2, label="95 %"),
            Line2D(
                [], [], color=VERMILION, marker="D", ls="none", ms=6, mec="black", mew=0.6, label="fANOVA"
            ),
            Line2D(
                [], [], color=ORANGE, marker="o", ls="none", ms=6, mec="black", mew=0.6, label="PED-ANOVA"
            ),
        ]
        figure.legend(handles=handles, loc="outside upper center", ncols=5)
        if result.caution:
            ax.set_title(result.caution, fontsize=8.5, color=VERMILION, wrap=True)
        return figure


def interaction_figure(result: Sensitivity) -> Figure:
    """The surrogate over two parameters, all others averaged, with the missions that were flown."""
    pair = result.interaction
    assert pair is not None
    space = result.data.space
    first, second = (next(p for p in space.parameters if p.path == path) for path in pair.paths)
    with look():
        figure = new_figure(5.8, 4.3)
        ax = figure.subplots()
        image = ax.imshow(
            pair.mean.T,
            origin="lower",
            extent=(0, 1, 0, 1),
            aspect="auto",
            cmap=SEQUENTIAL,
            interpolation="bilinear",
        )
        lines = ax.contour(
            pair.mean.T, levels=6, colors="white", linewidths=0.7, extent=(0, 1, 0, 1), origin="lower"
        )
        lines.set(path_effects=[withStroke(linewidth=1.8, foreground="#00000088")])
        for text in ax.clabel(lines, fontsize=7.5):
            text.set_path_effects([withStroke(linewidth=1.8, foreground="#00000088")])
        seen = np.unique(
            [
                [first.to_unit(o.values[first.path]), second.to_unit(o.values[second.path])]
                for o in result.data.observations
            ],
            axis=0,
        )
        ax.plot(seen[:, 0], seen[:, 1], "o", ms=4, mfc="white", mec=BLACK, mew=0.7, ls="none", clip_on=False)
        ticks = np.linspace(0, 1, 5)
        ax.set_xticks(ticks, [parameter_value(first.from_unit(u)) for u in ticks])
        ax.set_yticks(ticks, [parameter_value(second.from_unit(u)) for u in ticks])
        ax.set_xlabel(parameter_label(first.path).axis)
        ax.set_ylabel(parameter_label(second.path).axis)
        ax.grid(False)
        bar = figure.colorbar(image, ax=ax)
        bar.set_label(f"{metric_label(result.data.objective.metric).axis}, mean over rocks")
        low, high = pair.second_belief
        ax.set_title(
            f"Interaction: {format_number(pair.second, 2)} of the variance "
            f"({format_number(low, 2)} to {format_number(high, 2)}); dots: missions"
        )
        return figure
