"""Completeness by azimuth sector as a polar plot (the paper's Fig. 3), sector centres labelled."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from nbv.types import Floats
from tuner.report.style import colour, look, marker, new_figure


def mean_sectors(missions: Sequence[Sequence[float | None]]) -> Floats:
    """(K,) mean completeness per sector over missions; NaN where no mission has a sample there."""
    table = np.array([[np.nan if v is None else v for v in mission] for mission in missions], dtype=float)
    known = ~np.isnan(table)
    total = np.where(known, table, 0.0).sum(0)
    return np.where(known.any(0), total / np.maximum(known.sum(0), 1), np.nan)


def sector_figure(
    completeness: Mapping[str, Sequence[Sequence[float | None]]],
    centers_deg: Sequence[float],
    threshold: str = "48 mm",
) -> Figure:
    """Mean completeness per sector and label.

    Parameters
    ----------
    completeness
        By label: one list of K percentages per mission.
    centers_deg
        (K,) azimuths of the sector centres, counter-clockwise from east, as ``nbv.evaluation`` defines them.
    """
    with look():
        figure = new_figure(6.6, 4.8)
        ax: Any = figure.add_subplot(projection="polar")
        angles = np.deg2rad(np.asarray(centers_deg, dtype=float))
        lowest = 100.0
        for i, (label, missions) in enumerate(completeness.items()):
            mean = mean_sectors(missions)
            if np.isnan(mean).all():
                continue
            lowest = min(lowest, float(np.nanmin(mean)))
            ax.plot(
                np.append(angles, angles[0]),
                np.append(mean, mean[0]),
                color=colour(i),
                marker=marker(i),
                ms=4.5,
                label=f"{label}" + (f" (n = {len(missions)})" if len(missions) > 1 else ""),
            )
        bottom = 0.0 if lowest < 40 else 10 * np.floor(lowest / 10) - 10
        ax.set_ylim(bottom, 100)
        ax.yaxis.set_major_locator(MaxNLocator(4))
        ax.yaxis.set_major_formatter("{x:g} %")
        ax.set_xticks(angles, [f"{center:g}°" for center in centers_deg])
        ax.set_xlabel(
            f"completeness at {threshold}; 0° east, 90° north, labels at sector centres; "
            f"the plot’s centre is {bottom:g} %",
            fontsize=8,
        )
        ax.legend(loc="center left", bbox_to_anchor=(1.14, 0.5))
        return figure
