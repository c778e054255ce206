"""The picture of how few photographs would have done: quality over number, and where those that would do were taken."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from nbv.photographs import PhotographSet
from tuner.evaluation.enough import ORACLE, WAYS, Enough
from tuner.report.style import BLUE, GREY, LIGHT, MARKERS, colour, look, new_figure


def draw_enough(found: Enough, photographs: PhotographSet, keep_percent: float, path: Path) -> Path:
    """Write the picture as PNG; returns its path."""
    with look():
        figure = new_figure(7.2, 7.4)
        above, below = figure.subplots(2, 1, height_ratios=(3, 2))
        for k, (way, points) in enumerate(found.curves.items()):
            number = np.array([p.photographs for p in points])
            mean = np.array([p.quality.mean for p in points])
            style = "--" if way == ORACLE else "-"
            above.plot(number, mean, style, marker=MARKERS[k], color=colour(k), markersize=4, label=WAYS[way])
            low, high = (
                np.array(
                    [getattr(p.quality, end) if p.quality.low is not None else np.nan for p in points],
                    dtype=float,
                )
                for end in ("low", "high")
            )
            above.fill_between(
                number, np.clip(low, 0, 100), np.clip(high, 0, 100), color=colour(k), alpha=0.12, lw=0
            )
        above.axhline(found.all_quality, color=GREY, lw=1)
        above.axhline(found.asked_quality, color=GREY, lw=1, ls=":")
        left = above.get_xlim()[0]
        above.text(
            left, found.all_quality, f" all {found.all_photographs:.0f}", va="bottom", color=GREY, fontsize=8
        )
        above.text(
            left, found.asked_quality, f" {keep_percent:g} % of that", va="top", color=GREY, fontsize=8
        )
        above.set_xlabel("photographs")
        above.set_ylabel("F-score at 3 % of the height, %")
        above.legend(loc="lower right")
        views = photographs.coverage
        azimuth, elevation = views.azimuths_deg, views.elevations_deg
        below.scatter(azimuth, elevation, s=14, color=LIGHT, edgecolor=GREY, lw=0.5, label="not needed")
        if found.smallest is not None:
            chosen = np.isin(views.names, found.smallest.taken)
            label = f"these {chosen.sum()} would have done"
            below.scatter(azimuth[chosen], elevation[chosen], s=22, color=BLUE, label=label)
        below.set_xlim(0, 360)
        below.set_xticks(range(0, 361, 45))
        below.set_xlabel("azimuth about the object, degrees")
        below.set_ylabel("elevation, degrees")
        below.legend(loc="upper right", ncols=2)
        figure.savefig(path, dpi=130)
    return path
