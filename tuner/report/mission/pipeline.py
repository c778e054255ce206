"""The pipeline's state at every adaptive iteration."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator

from nbv.errors import UserError
from tuner.evaluation.baselines import label as strategy_label
from tuner.report.mission.run_files import mission_config, read_trace
from tuner.report.style import BLUE, GREEN, GREY, ORANGE, PURPLE, SKY, VERMILION, look, new_figure


def pipeline_figure(run: Path) -> Figure:
    """Per adaptive iteration: scorer flown, d95 with the gate's threshold, sparse points, registered images.

    Raises
    ------
    UserError
        There is no trace, or it is empty.
    """
    config, trace = mission_config(run), read_trace(run)
    if not trace:
        raise UserError(f"{run} flew no adaptive capture; there is nothing to show")
    k = np.array([record["iteration"] + 1 for record in trace])
    colours = {"b-aware": VERMILION, "covis": BLUE}
    scorers = [str(record["scorer"]) for record in trace]
    kinds = list(dict.fromkeys(scorers))
    spare = iter((GREEN, PURPLE, ORANGE, SKY, GREY))
    shade = {kind: colours.get(kind) or next(spare) for kind in kinds}
    with look():
        figure = new_figure(8.2, 6.4)
        axes = figure.subplots(4, 1, sharex=True, height_ratios=(0.55, 1.2, 1, 1))
        axes[0].bar(k, np.ones(len(k)), width=0.92, color=[shade[name] for name in scorers])
        for x, record in zip(k, trace):
            top, text = record.get("top", {}), ""
            picks = {name: best.get("candidate") for name, best in top.items()}
            if len(set(picks.values())) == 1 and len(picks) > 1:
                text = "="
            axes[0].text(x, 0.5, text, ha="center", va="center", color="white", fontsize=10)
        axes[0].set_yticks([])
        axes[0].grid(False)
        axes[0].set_ylabel("scorer", rotation=0, ha="right", va="center")
        axes[1].plot(k, [1000 * record["d95_m"] for record in trace], "-o", color=BLUE, ms=4)
        if config.gate.kind == "hyb-h":
            axes[1].axhline(1000 * config.gate.d95_m, color=VERMILION, ls="--", lw=1.2)
            axes[1].annotate(
                f"gate threshold {1000 * config.gate.d95_m:.0f} mm",
                (1, 1000 * config.gate.d95_m),
                xycoords=axes[1].get_yaxis_transform(),
                xytext=(0, 3),
                textcoords="offset points",
                ha="right",
                color=VERMILION,
                fontsize=8.5,
            )
            last = int(np.ceil(config.gate.budget_fraction * config.adaptive_budget))
            if 0 < last < k[-1]:
                for ax in axes[:2]:
                    ax.axvline(last + 0.5, color="black", ls=":", lw=1.3)
                axes[1].annotate(
                    f"$f_b$ reaches {config.gate.budget_fraction:g}",
                    (last + 0.5, 1),
                    xycoords=axes[1].get_xaxis_transform(),
                    xytext=(4, -10),
                    textcoords="offset points",
                    fontsize=8.5,
                )
        axes[1].set_ylabel("d95 (mm)")
        axes[2].plot(k, [record["n_points"] for record in trace], "-o", color=GREEN, ms=4)
        axes[2].set_ylabel("sparse points")
        seeds = config.seed.total
        axes[3].plot(
            k, [seeds + x - 1 for x in k], color="black", ls=":", lw=1.6, zorder=5, label="photographs taken"
        )
        axes[3].plot(
            k, [record["n_registered"] for record in trace], "-o", color=PURPLE, ms=4, label="registered"
        )
        lost = [x for x, record in zip(k, trace) if not record["registered"]]
        if lost:
            axes[3].plot(
                lost,
                np.full(len(lost), 0.06),
                "x",
                color=VERMILION,
                ms=7,
                mew=1.8,
                transform=axes[3].get_xaxis_transform(),
                label="new image did not register",
            )
        axes[3].set_ylabel("images")
        axes[3].legend(loc="upper left", ncols=3)
        axes[3].set_xlabel("adaptive iteration; every value is the state before its capture")
        for ax in axes[1:]:
            ax.margins(y=0.18)
            ax.yaxis.set_major_locator(MaxNLocator(4, integer=True))
        axes[3].xaxis.set_major_locator(MaxNLocator(integer=True, min_n_ticks=1))
        axes[0].set_xlim(0.4, k[-1] + 0.6)
        handles = [Line2D([], [], color=shade[kind], lw=7, label=strategy_label(kind)) for kind in kinds]
        if len(trace[0].get("top", {})) > 1:
            handles.append(
                Line2D(
                    [],
                    [],
                    ls="none",
                    marker="$=$",
                    ms=9,
                    mew=0,
                    color=GREY,
                    label="all scorers prefer the same view",
                )
            )
        figure.legend(handles=handles, loc="outside upper center", ncols=4)
        figure.align_ylabels(axes[1:])
        return figure
