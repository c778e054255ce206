"""Two objectives in a campaign's report: the Pareto front as a figure and a table."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from tuner.acquisition.two_objectives import FrontPoint, pareto_front
from tuner.problem.objective import reached
from tuner.problem.quality_at_cost import COUNTS
from tuner.report.answer import place_word
from tuner.report.campaign.facts import CampaignFacts
from tuner.report.labels import believed, metric_label, parameter_value, with_unit
from tuner.report.style import BLACK, BLUE, GREY, VERMILION, embed, look, new_figure
from tuner.surrogate.numerics import NORMAL_95


def asked_text(facts: CampaignFacts) -> str:
    """What the campaign was asked for, in words."""
    s, label = facts.settings, metric_label(facts.settings.objective.metric)
    less = "Fewest" if s.objective.metric in COUNTS else "Lowest"
    full = label.full[:1].lower() + label.full[1:] if less == "Fewest" else label.full
    said = f"{less if s.objective.direction == 'minimise' else 'Highest'} {full}"
    if s.second is None:
        return said
    name = metric_label(s.second.metric).full
    assert s.limit is not None
    if share := reached(s.second.metric):
        of = metric_label(share[0])
        return f"{said} with {of.full} of {of.value(share[1])} on at least {s.limit:g} % of rocks"
    bound = with_unit(s.limit, metric_label(s.second.metric).unit, 0 if s.limit == int(s.limit) else 2)
    return f"{said} with {name} {'at most' if s.second.direction == 'minimise' else 'at least'} {bound}"


def front_context(facts: CampaignFacts, figures: Path) -> dict[str, Any] | None:
    """What the page's section needs; None for a campaign with one objective, or without a mission that has both."""
    s = facts.settings
    points = facts.campaign.flown_in_both()
    if s.second is None or not points:
        return None
    front = pareto_front(points, (s.objective, s.second))
    one, two = metric_label(s.objective.metric), metric_label(s.second.metric)
    return {
        "figure": embed(
            front_figure(facts, points, front),
            "front",
            f"Scatter plot of {one.name} against {two.name} of all configurations flown; the Pareto front is a line.",
            f"{one.full} ({s.objective.direction}d) against {two.name} ({s.second.direction}d): what the model believes of "
            f"every configuration flown, as means over the training {place_word(s)}s, with 95 % bars on the front where it is not known exactly.",
            figures,
            title="Both objectives",
            form="png",
        ),
        "first": one.axis,
        "second": two.axis,
        "choice": "The recommendation above is the best by the first that keeps the limit of the second.",
        "rows": [
            [
                believed(p.first, p.first_sd, one),
                believed(p.second, p.second_sd, two),
                *(parameter_value(p.values[path]) for path in s.space.paths),
            ]
            for p in front
        ],
    }


def front_figure(facts: CampaignFacts, points: list[FrontPoint], front: list[FrontPoint]) -> Figure:
    """All configurations, the front as a line with 95 % bars, the default and the recommendation marked."""
    s = facts.settings
    assert s.second is not None
    with look():
        figure = new_figure(7.4, 4.2)
        ax = figure.subplots()
        ax.plot(
            [p.second for p in points],
            [p.first for p in points],
            "o",
            color=GREY,
            ms=4,
            mec="white",
            mew=0.3,
            label="configurations flown",
        )
        ax.errorbar(
            [p.second for p in front],
            [p.first for p in front],
            xerr=[NORMAL_95 * p.second_sd for p in front],
            yerr=[NORMAL_95 * p.first_sd for p in front],
            fmt="-o",
            color=BLUE,
            ms=5,
            lw=1.3,
            elinewidth=0.7,
            capsize=2,
            label="Pareto front, 95 %",
        )
        marked = {"default": (facts.default, "D", BLACK)}
        if facts.recommendation is not None:
            marked["recommended"] = (facts.recommendation.values, "s", VERMILION)
        for label, (values, shape, colour) in marked.items():
            at = s.space.to_unit(values)
            own = [p for p in points if np.allclose(s.space.to_unit(p.values), at)]
            ax.plot(
                [p.second for p in own],
                [p.first for p in own],
                shape,
                ms=10,
                mfc="none",
                mec=colour,
                mew=1.6,
                ls="none",
                label=label,
            )
        if s.limit is not None:
            ax.axvline(s.limit, color=VERMILION, ls="--", lw=1.2, label=f"limit {s.limit:g}")
        ax.set_xlabel(metric_label(s.second.metric).axis)
        ax.set_ylabel(metric_label(s.objective.metric).axis)
        figure.legend(*ax.get_legend_handles_labels(), loc="outside lower center", ncols=2)
        return figure
