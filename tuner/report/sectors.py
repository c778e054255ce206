"""Completeness by azimuth sector as a polar plot (the paper's Fig. 3), sector centres labelled."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from nbv.types import Floats
from tuner.report.style import colour, look, marker, new_figure

_COMPASS = {0: "E", 90: "N", 180: "W", 270: "S"}


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
                lw=1.7,
                mec="white",
                mew=0.4,
                label=f"{label}" + (f" (n = {len(missions)})" if len(missions) > 1 else ""),
            )
        ax.set_theta_zero_location("E")
        ax.set_theta_direction(1)
        names = []
        for center in centers_deg:
            near = next((n for a, n in _COMPASS.items() if abs((center - a + 180) % 360 - 180) < 1e-6), "")
            names.append(f"{center:g}°{' ' + near if near else ''}")
        ax.set_xticks(angles, names)
        for azimuth_deg, letter in _COMPASS.items():  # where no sector's centre lies there
            if not any(name.endswith(letter) for name in names):
                a = np.deg2rad(azimuth_deg)
                ax.text(
                    0.5 + 0.535 * np.cos(a),
                    0.5 + 0.535 * np.sin(a),
                    letter,
                    transform=ax.transAxes,
                    ha="center",
                    va="center",
                    fontsize=9.5,
                    weight="bold",
                    color="#444444",
                )
        floor = 0.0 if lowest < 40 else 10 * np.floor(lowest / 10) - 10
        ax.set_ylim(max(0.0, floor), 100)
        # Texts of our own: the lines pass behind them, over tick labels they would be drawn.
        bottom = max(0.0, floor)
        rings = [r for r in MaxNLocator(5).tick_values(bottom, 100.0) if bottom < r < 100.0]
        ax.set_yticks(rings, [""] * len(rings))
        between = float(angles[0] + np.diff(angles[:2])[0] / 2) if len(angles) > 1 else np.deg2rad(20)
        for ring in rings:
            ax.text(
                between,
                ring,
                f"{ring:g} %",
                fontsize=7.5,
                ha="center",
                va="center",
                zorder=6,
                bbox={"facecolor": "white", "alpha": 0.8, "linewidth": 0, "pad": 0.8},
            )
        ax.text(
            0.0,
            -0.1,
            f"completeness at {threshold}\nazimuth from the target: 0° east, 90° north\nlabels at sector centres; the plot’s centre is {bottom:g} %",
            transform=ax.transAxes,
            fontsize=8,
            va="top",
            ha="left",
        )
        ax.legend(loc="center left", bbox_to_anchor=(1.14, 0.5))
        return figure
