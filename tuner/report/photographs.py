"""Pages and pictures about sets of real photographs: what an import found, and how few would have been enough."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from nbv.photographs import Coverage, PhotographSet, Reference
from nbv.photographs.photograph_set import THRESHOLD_FRACTIONS
from tuner.comparison.enough import WAYS, Enough
from tuner.report.labels import difference_text
from tuner.report.pages import write_page
from tuner.report.style import (
    BLUE,
    GREY,
    LIGHT,
    MARKERS,
    SEQUENTIAL,
    embed,
    look,
    new_figure,
    save_figure,
)
from tuner.report.table import Table

REPORT_FILE = "report.html"
MIDDLE = 2  # of THRESHOLD_FRACTIONS, which the page speaks of
_SIDES = (("from azimuth 0°", 0.0), ("from 90°", 90.0), ("from 180°", 180.0), ("from 270°", 270.0))
_DOTS = 40_000


def write_import_report(photographs: PhotographSet, directory: Path | None = None) -> Path:
    """Write ``report.html`` into the set's folder, or another one; returns its path.

    Raises `UserError`: the page cannot be written, or a file of the set is damaged.
    """
    views = photographs.coverage
    reference = photographs.reference()
    registered, total = len(photographs.registered), len(photographs.photographs)
    height_m = photographs.true_height_m
    return write_page(
        (directory or photographs.folder) / REPORT_FILE,
        "photographs.html.j2",
        title=f"{photographs.name} · photographs · gatetune",
        photographs=photographs,
        verdict=f"{registered} of {total} photographs make one model of the object.",
        height="unknown: no scale was given" if height_m is None else f"{height_m:.3g} m",
        ceiling=photographs.halves.f_score[MIDDLE],
        middle=100 * THRESHOLD_FRACTIONS[MIDDLE],
        error_percent=100 * photographs.reference_error_m / photographs.height_m,
        cameras=embed(_cameras(views)),
        errors=embed(_errors(photographs, reference), "png"),
        halves=_halves(photographs),
        can=_can(photographs, views),
        cannot=_cannot(views),
        absent=[p.source for p in photographs.photographs if not p.registered],
    )


def _halves(photographs: PhotographSet) -> Table:
    """How one half of the photographs agrees with the other, by threshold."""
    halves = photographs.halves
    rows = zip(THRESHOLD_FRACTIONS, halves.completeness, halves.precision, halves.f_score, strict=True)
    head = ("threshold, % of the height", "completeness, %", "precision, %", "F-score, %")
    return Table.of(
        "", head, [(f"{100 * fraction:.0f}", *(f"{v:.1f}" for v in values)) for fraction, *values in rows]
    )


def _can(photographs: PhotographSet, views: Coverage) -> list[str]:
    low, high = np.percentile(views.elevations_deg, [5, 95])
    near, far = np.percentile(views.distances_m, [5, 95])
    return [
        f"Plans with up to {len(views.names)} photographs, seeds included.",
        f"Elevations of {low:.0f}° to {high:.0f}° about the object's centre; nine tenths of the photographs lie there.",
        f"Distances of {near:.1f} to {far:.1f} units ({near / photographs.height_m:.1f} to {far / photographs.height_m:.1f} "
        "times the object's height).",
    ]


def _cannot(views: Coverage) -> list[str]:
    lines = [
        f"Photographs between azimuth {start:.0f}° and {end:.0f}°: none was taken there."
        for start, end in views.gaps_deg
    ]
    return [*lines, "Other light, wind, lens or position of the object."]


def _cameras(views: Coverage) -> Figure:
    """Where the photographs were taken, seen from the object; azimuths without photographs are shaded."""
    with look():
        figure = new_figure(9.6, 3.2)
        axes = figure.subplots()
        for start, end in views.gaps_deg:
            for low, high in ((start, end),) if start < end else ((start, 360.0), (0.0, end)):
                axes.axvspan(low, high, color="#f3d9cc", lw=0)
        dots = axes.scatter(
            views.azimuths_deg, views.elevations_deg, c=views.distances_m, cmap=SEQUENTIAL, s=22
        )
        figure.colorbar(dots, ax=axes, label="distance, units", format="%.1f")
        axes.set(xlim=(0, 360), xticks=range(0, 361, 60), xlabel="azimuth, °", ylabel="elevation, °")
    return figure


def _errors(photographs: PhotographSet, reference: Reference) -> Figure:
    limit = 100 * THRESHOLD_FRACTIONS[-1]
    error = 100 * reference.error_m / photographs.height_m
    step = max(1, len(reference) // _DOTS)
    points, error = reference.points_m[::step], error[::step]
    with look():
        width, depth, height = photographs.extents_m
        ratio = height / max(width, depth)
        figure = new_figure(9.6, min(4.2, 8.0 / len(_SIDES) * ratio + 1.0))
        panels = figure.subplots(1, len(_SIDES))
        for axes, (title, azimuth_deg) in zip(panels, _SIDES, strict=True):
            azimuth = np.deg2rad(azimuth_deg)
            toward = points[:, 0] * np.cos(azimuth) + points[:, 1] * np.sin(azimuth)
            across = -points[:, 0] * np.sin(azimuth) + points[:, 1] * np.cos(azimuth)
            order = np.argsort(toward)
            shown = {"cmap": SEQUENTIAL, "norm": Normalize(0, limit), "s": 0.6, "lw": 0}
            dots = axes.scatter(across[order], points[order, 2], c=error[order], **shown)
            axes.set_aspect("equal")
            axes.set_title(title)
        figure.colorbar(dots, ax=panels, label="error, % of height")
    return figure


def enough_table(enough: Enough) -> Table:
    rows = [
        (WAYS[way], f"{p.photographs:.1f}", f"{p.registered:.1f}", difference_text(p.quality, signed=False))
        for way, points in enough.curves.items()
        for p in points
    ]
    title = (
        f"F-score at 3 % of the height; one half of all photographs against the other: {enough.ceiling:.1f} %"
    )
    return Table.of(title, ("way", "photographs", "registered", "F-score, % [95 % interval]"), rows)


def enough_text(enough: Enough, keep_percent: float, listed: Path) -> str:
    """Which plan would have been enough; ``listed``: the file that names its photographs."""
    said = f"All {enough.all_photographs:.0f} have {enough.all_quality:.1f} %; {keep_percent:g} % of that are {enough.asked_quality:.1f} %."
    if (best := enough.smallest) is None:
        return f"{said} No plan's lower bound reached it: try a larger --number or more --replicates."
    return (
        f"{said} {best.plan.photographs:.0f} photographs would have been enough: {WAYS[best.way]}, "
        f"{difference_text(best.plan.quality, signed=False)} %. The files of a typical mission, {best.quality:.1f} %: {listed}."
    )


def draw_enough(enough: Enough, photographs: PhotographSet, keep_percent: float, path: Path) -> Path:
    """Write the picture as PNG; returns its path."""
    with look():
        figure = new_figure(7.2, 7.4)
        above, below = figure.subplots(2, 1, height_ratios=(3, 2))
        for k, (way, points) in enumerate(enough.curves.items()):
            number = np.array([p.photographs for p in points])
            mean = np.array([p.quality.mean for p in points])
            above.plot(number, mean, "-", marker=MARKERS[k], color=f"C{k}", markersize=4, label=WAYS[way])
            bounds = np.array([(p.quality.low, p.quality.high) for p in points], dtype=float)  # None: NaN
            low, high = bounds.T
            above.fill_between(number, low, high, color=f"C{k}", alpha=0.12, lw=0)
        small = {"color": GREY, "fontsize": 8}
        left = above.get_xlim()[0]
        above.axhline(enough.all_quality, color=GREY, lw=1)
        above.axhline(enough.asked_quality, color=GREY, lw=1, ls=":")
        above.text(left, enough.all_quality, f" all {enough.all_photographs:.0f}", va="bottom", **small)
        above.text(left, enough.asked_quality, f" {keep_percent:g} % of that", va="top", **small)
        above.set_xlabel("photographs")
        above.set_ylabel("F-score at 3 % of the height, %")
        above.legend(loc="lower right")
        views = photographs.coverage
        azimuth, elevation = views.azimuths_deg, views.elevations_deg
        below.scatter(azimuth, elevation, s=14, color=LIGHT, edgecolor=GREY, lw=0.5, label="not needed")
        if enough.smallest is not None:
            chosen = np.isin(views.names, enough.smallest.taken)
            label = f"these {chosen.sum()} would have been enough"
            below.scatter(azimuth[chosen], elevation[chosen], s=22, color=BLUE, label=label)
        below.set_xlim(0, 360)
        below.set_xticks(range(0, 361, 45))
        below.set_xlabel("azimuth about the object, degrees")
        below.set_ylabel("elevation, degrees")
        below.legend(loc="upper right", ncols=2)
    return save_figure(figure, path.parent, path.stem)
