"""Ground truth and dense cloud, coloured by error: the paper's Fig. 4."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure

from nbv.cache import Store
from nbv.errors import UserError
from nbv.geometry.neighbours import nearest_neighbours
from nbv.geometry.raycasting import RayCaster
from nbv.geometry.sampling import sample_surface
from nbv.mission.run_directory import read_ply
from nbv.rocks import load_rock
from nbv.terrain import buried_rock
from nbv.types import Floats, Ints
from tuner.report.labels import format_number
from tuner.report.mission.run_files import mission_config
from tuner.report.mission.thinning import thin_indices
from tuner.report.style import BLUE, ORANGE, SKY, VERMILION, look, new_figure

MAX_CLOUD_POINTS = 60_000  # more than a pixel each at the printed size
# Ends of the colour bars, fixed so that missions compare: 1 % and 5 % of the rock's height.
CLOUD_ERROR_RANGE_MM = 16.0
MISSING_RANGE_MM = 80.0


_VIEWS = (
    (-60.0, 18.0),
    (120.0, 18.0),
)  # azimuth (from east, counter-clockwise) and elevation of the two cameras


def overlay_figure(run: Path, rock: str) -> Figure:
    """Ground truth and cleaned dense cloud from two opposite sides, coloured by error.

    Upper row: the cloud, each point coloured by its distance to the true surface. Lower row: samples of the true
    surface, coloured by their distance to the cloud: what is missing shows dark. Parallel projection.

    Parameters
    ----------
    run
        A mission's directory with ``cleaned.ply``.
    rock
        Catalogue name or mesh file, as the mission was flown with.

    Raises
    ------
    UserError
        A file is missing or the rock is unknown.
    """
    config = mission_config(run)
    cloud = read_ply(run / "cleaned.ply").points_m
    if len(cloud) == 0:
        raise UserError(f"{run / 'cleaned.ply'} holds no points")
    subject = buried_rock(load_rock(rock, Store()), config)
    wrong_m, cloud_normals = _distance_to_mesh(cloud, subject.vertices_m, subject.faces)
    # The same samples as the metrics: same count, same seed.
    samples, normals = sample_surface(subject.vertices_m, subject.faces, config.evaluation.gt_samples, 0)
    wrong_mm, missing_mm = 1000 * wrong_m, 1000 * nearest_neighbours(cloud, samples)[0]
    shades = LinearSegmentedColormap.from_list("error", ["#cfe8f7", SKY, BLUE, ORANGE, VERMILION, "#3a0f00"])
    reach = float(np.abs(samples[:, :2]).max()) * 1.05
    top = float(samples[:, 2].max()) * 1.05
    with look():
        figure = new_figure(9.4, 7.4)
        axes = figure.subplots(2, 2, sharex=True, sharey=True)
        # A point is drawn on the side that its surface faces, so that the back does not shine through.
        sets = (
            (
                cloud,
                wrong_mm,
                cloud_normals,
                "dense cloud",
                "distance to true surface (mm)",
                CLOUD_ERROR_RANGE_MM,
            ),
            (samples, missing_mm, normals, "truth", "distance to dense cloud (mm)", MISSING_RANGE_MM),
        )
        for row, (points, error_mm, facing, name, unit, span_mm) in enumerate(sets):
            mappable: Any = None
            for column, (azimuth_deg, elevation_deg) in enumerate(_VIEWS):
                ax = axes[row, column]
                right, up, towards = _camera_axes(azimuth_deg, elevation_deg)
                keep = np.flatnonzero(facing @ towards > 0)
                keep = keep[thin_indices(len(keep), MAX_CLOUD_POINTS)]
                order = keep[np.argsort(points[keep] @ towards, kind="stable")]  # far points first
                centred = points[order] - np.array(config.target_m)
                mappable = ax.scatter(
                    centred @ right,
                    centred @ up,
                    c=error_mm[order],
                    cmap=shades,
                    vmin=0,
                    vmax=span_mm,
                    s=1.8 if row == 0 else 5.0,
                    linewidths=0,
                    rasterized=True,
                )
                ax.set_aspect("equal")
                ax.grid(False)
                ax.set_xlim(-reach * 1.1, reach * 1.1)
                ax.set_ylim(-top * 0.62, top * 0.62)
                if row == 0:
                    ax.set_title(
                        f"from {_compass(azimuth_deg)} ({azimuth_deg % 360:.0f}°), {elevation_deg:.0f}° up"
                    )
                else:
                    ax.set_xlabel("right of target (m)")
                if column == 0:
                    ax.set_ylabel(f"{name}\nabove target (m)")
            bar = figure.colorbar(
                mappable, ax=list(axes[row]), location="right", shrink=0.85, aspect=18, extend="max"
            )
            bar.set_label(unit)
            bar.set_ticks(np.linspace(0, span_mm, 5).tolist())
        figure.suptitle(
            f"{run.name}: {len(cloud):,} points; {100 * np.mean(missing_mm < 48):.0f} % of the whole true surface within "
            f"48 mm of the cloud, median error of the cloud {format_number(float(np.median(wrong_mm)), 1)} mm",
            fontsize=10,
        )
        return figure


def _distance_to_mesh(points: Floats, vertices_m: Floats, faces: Ints) -> tuple[Floats, Floats]:
    """(N,) distances to the surface itself and (N, 3) normals at the nearest places.

    Not to samples of it, as the metrics have them: at 50,000 samples their spacing alone is several millimetres,
    more than the error of a good cloud.
    """
    places, normals = RayCaster(vertices_m, faces).nearest(points)
    return np.linalg.norm(points - places, axis=1), normals


def _camera_axes(azimuth_deg: float, elevation_deg: float) -> tuple[Floats, Floats, Floats]:
    """Right, up and towards-the-camera unit vectors of an orthographic view from that side."""
    a, e = np.deg2rad(azimuth_deg), np.deg2rad(elevation_deg)
    towards = np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])
    right = np.array([-np.sin(a), np.cos(a), 0.0])
    return right, np.cross(towards, right), towards


def _compass(azimuth_deg: float) -> str:
    names = ("east", "north-east", "north", "north-west", "west", "south-west", "south", "south-east")
    return names[round(azimuth_deg / 45) % 8]
