"""Figures of a study of transfer: the tuned configuration world by world, and worlds against each other."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from nbv.evaluation.registry import find_metric
from research.transfer.study import TransferFindings
from tuner.evaluation.baselines import TUNED
from tuner.evaluation.comparison import PairedDifference
from tuner.report.labels import format_number, metric_label
from tuner.report.style import BLUE, GREY, ORANGE, SEQUENTIAL, look, new_figure


def gains_figure(findings: TransferFindings) -> Figure | None:
    """Tuned minus Hyb-H and minus random views in its pool, with intervals; None without a pair of missions."""
    series: list[tuple[str, str, float, list[PairedDifference | None]]] = [
        ("minus Hyb-H", BLUE, -0.12, [w.configuration(TUNED).difference for w in findings.worlds]),
        ("minus random in its pool", ORANGE, 0.12, [w.tuned_minus_random for w in findings.worlds]),
    ]
    if not any(d for *_, differences in series for d in differences):
        return None
    metric = metric_label(findings.settings.metric)
    with look():
        figure = new_figure(7.4, 0.42 * len(findings.worlds) + 1.4)
        ax = figure.subplots()
        ax.axvline(0, color=GREY, lw=0.8)
        for name, shade, shift, differences in series:
            for y, d in enumerate(differences):
                if d is None:
                    continue
                i = d.interval
                if i.low is not None and i.high is not None:
                    ax.plot([i.low, i.high], [y + shift] * 2, color=shade, lw=1.6)
                ax.plot(i.mean, y + shift, "o", color=shade, ms=5)
            ax.plot([], [], "-o", color=shade, ms=5, label=f"tuned {name}")
        ax.set_yticks(range(len(findings.worlds)), [w.name for w in findings.worlds])
        ax.set_ylim(len(findings.worlds) - 0.5, -0.5)
        found = find_metric(findings.settings.metric.split(".")[-1])
        better = "left" if found is None or not found[0].larger_is_better else "right"
        ax.set_xlabel(f"{metric.name} ({metric.difference_unit}); {better} is better")
        ax.grid(False, axis="y")
        figure.legend(*ax.get_legend_handles_labels(), loc="outside upper center", ncols=2)
        return figure


def matrix_figure(findings: TransferFindings) -> Figure | None:
    """Rank correlation and regret, chosen in (rows) and flown in (columns); None with one world."""
    names = [w.name for w in findings.worlds]
    if len(names) < 2:
        return None
    rank, lost = (np.full((len(names), len(names)), np.nan) for _ in range(2))
    for (first, second), pair in findings.pairs.items():
        at = names.index(first), names.index(second)
        if pair.spearman.value is not None:
            rank[at] = pair.spearman.value
        if pair.regret.value is not None:
            lost[at] = pair.regret.value
    unit = metric_label(findings.settings.metric).difference_unit
    with look():
        figure = new_figure(9.6, 0.5 * len(names) + 2.2)
        axes = figure.subplots(1, 2)
        reversed_map = f"{SEQUENTIAL}_r"  # dark is bad in both
        top = max(1e-9, float(np.nanmax(lost))) if np.isfinite(lost).any() else 1.0
        panels = [
            ("Spearman correlation", rank, SEQUENTIAL, (-1.0, 1.0)),
            (f"regret ({unit})", lost, reversed_map, (0.0, top)),
        ]
        for ax, (title, values, colours, limits) in zip(axes, panels):
            ax.imshow(values, cmap=colours, vmin=limits[0], vmax=limits[1])
            for y, x in zip(*np.nonzero(np.isfinite(values))):
                share = (values[y, x] - limits[0]) / (limits[1] - limits[0])
                light = share > 0.55 if colours == SEQUENTIAL else share < 0.45
                text = format_number(float(values[y, x]), 2)
                ax.text(x, y, text, ha="center", va="center", fontsize=8, color="black" if light else "white")
            ax.set_xticks(range(len(names)), names, rotation=35, ha="right")
            ax.set_yticks(range(len(names)), names)
            ax.set_title(title)
            ax.set_xlabel("flown in")
            ax.grid(False)
        axes[0].set_ylabel("chosen in")
        return figure
