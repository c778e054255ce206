"""Completeness by azimuth sector as a polar plot (the paper's Fig. 3), sector centres labelled."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from nbv.errors import UserError
from nbv.mission.result import MissionResult
from tuner.report.style import colour, look, marker, new_figure


def sectors_figure(runs: Mapping[str, Path]) -> Figure:
    """Per-sector completeness at 48 mm of several missions, by label (the paper's Fig. 3).

    Sector centres are azimuths in degrees, counter-clockwise from east, as ``nbv.evaluation`` defines them.

    Raises
    ------
    UserError
        A mission without metrics, or with other sectors than the first.
    """
    completeness: dict[str, list[float | None]] = {}
    centers: list[float] = []
    for label, run in runs.items():
        result = MissionResult.load(run)
        if result.status == "failed":
            raise UserError(f"{run} holds a failed mission ({result.reason}); leave it out")
        metrics = result.metrics
        here = list(metrics["sector_centers_deg"])
        if centers and here != centers:
            raise UserError(f"{run} was measured with other azimuth sectors; compare like with like")
        centers = here
        completeness[label] = metrics["whole"]["sector_completeness_48mm"]
    if not completeness:
        raise UserError("no mission to show; name at least one run directory")
    with look():
        figure = new_figure(6.6, 4.8)
        ax: Any = figure.add_subplot(projection="polar")
        angles = np.deg2rad(np.asarray(centers, dtype=float))
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
        ax.set_xticks(angles, [f"{center:g}°" for center in centers])
        ax.set_xlabel(
            f"completeness at 48 mm; 0° east, 90° north, labels at sector centres; "
            f"the plot’s centre is {bottom:g} %",
            fontsize=8,
        )
        ax.legend(loc="center left", bbox_to_anchor=(1.14, 0.5))
        return figure
