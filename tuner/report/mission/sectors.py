"""Completeness by azimuth sector as a polar plot (the paper's Fig. 3), sector centres labelled."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from tuner.report.style import colour, look, marker, new_figure


def sector_figure(
    completeness: Mapping[str, Sequence[float | None]], centers_deg: Sequence[float], threshold: str = "48 mm"
) -> Figure:
    """Completeness per sector and label.

    Parameters
    ----------
    completeness
        By label: K percentages; None where the sector has no sample.
    centers_deg
        (K,) azimuths of the sector centres, counter-clockwise from east, as ``nbv.evaluation`` defines them.
    threshold
        At which completeness is.
    """
    with look():
        figure = new_figure(6.6, 4.8)
        ax: Any = figure.add_subplot(projection="polar")
        angles = np.deg2rad(np.asarray(centers_deg, dtype=float))
        lowest = 100.0
        for i, (label, sectors) in enumerate(completeness.items()):
            values = np.array([np.nan if v is None else v for v in sectors], dtype=float)
            lowest = min(lowest, float(np.nanmin(values, initial=100.0)))
            ring = np.append(values, values[0])
            ax.plot(
                np.append(angles, angles[0]), ring, color=colour(i), marker=marker(i), ms=4.5, label=label
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
