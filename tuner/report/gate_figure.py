"""What a heuristic gate did in a mission, step by step, beside its thresholds."""

from __future__ import annotations

from collections.abc import Sequence

from nbv.config import GateConfig
from nbv.gates.base import COVIS
from nbv.mission.result import IterationRecord
from tuner.evaluation.baselines import label
from tuner.report.style import BLUE, GREY, ORANGE, embed, look, new_figure

_COLOURS = {COVIS.name: BLUE}  # any other scorer is the geometry scorer


def draw_gate(panels: Sequence[tuple[str, GateConfig, Sequence[IterationRecord]]]) -> str:
    """Return a figure as a data URI: a column per mission, (title, gate, trace) each.

    Above the fraction of the budget that is used, below it d95, each with its threshold; a mark is coloured by the scorer that
    chose the view, and hollow where both scorers had the same best view.
    """
    with look():
        figure = new_figure(4.2 * len(panels), 3.6)
        axes = figure.subplots(2, len(panels), sharex=True, sharey="row", squeeze=False)
        for column, (title, gate, trace) in enumerate(panels):
            steps = [r.iteration + 1 for r in trace]
            fractions = [r.gate_details.get("f_b", 0.0) for r in trace]
            for axis, values, threshold in (
                (axes[0, column], fractions, gate.budget_fraction),
                (axes[1, column], [r.d95_m for r in trace], gate.d95_m),
            ):
                axis.plot(steps, values, color=GREY, linewidth=1)
                axis.axhline(threshold, color="#444444", linestyle="--", linewidth=1)
                for step, value, record in zip(steps, values, trace):
                    bests = {str(best.get("candidate")) for best in record.top.values()}
                    colour = _COLOURS.get(record.scorer, ORANGE)
                    axis.plot(step, value, "o", color=colour, fillstyle="none" if len(bests) == 1 else "full")
            axes[0, column].set_title(title)
            axes[1, column].set_xlabel("planned view")
        axes[1, 0].set_yscale("log")
        axes[0, 0].set_ylabel("budget used")
        axes[1, 0].set_ylabel("d95 (m)")
        named = sorted({r.scorer for _, _, trace in panels for r in trace})
        for scorer in named:
            axes[0, 0].plot([], [], "o", color=_COLOURS.get(scorer, ORANGE), label=label(scorer))
        axes[0, 0].plot([], [], color="#444444", linestyle="--", label="threshold")
        axes[0, 0].legend(loc="best")
        return embed(figure)
