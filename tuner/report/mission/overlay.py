"""Ground truth and dense cloud, coloured by error: the paper's Fig. 4."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure

from nbv.cache import Store
from nbv.errors import UserError
from nbv.geometry.neighbours import nearest_neighbours
from nbv.geometry.raycasting import RayCaster
from nbv.geometry.sampling import sample_surface
from nbv.mission.result import MissionResult
from nbv.mission.run_directory import read_ply
from nbv.terrain import buried_rock
from nbv.types import Floats
from tuner.report.mission.run_files import mission_config, thin_indices
from tuner.report.mission.walk_world import the_rock
from tuner.report.style import BLUE, ORANGE, SKY, VERMILION, look, new_figure

MAX_CLOUD_POINTS = 60_000  # more than a pixel each at the printed size
# Ends of the colour bars, fixed so that missions compare: 1 % and 5 % of the rock's height.
CLOUD_ERROR_RANGE_MM = 16.0
MISSING_RANGE_MM = 80.0
_SIDES = {
    "south-east": -60.0,
    "north-west": 120.0,
}  # azimuths of the two cameras, counter-clockwise from east
_ELEVATION_DEG = 18.0


def overlay_figure(run: Path, rock: str | None = None) -> Figure:
    """Ground truth and cleaned dense cloud from two opposite sides, coloured by error.

    Upper row: the cloud, each point coloured by its distance to the true surface (not to samples of it, whose spacing
    is more than the error of a good cloud). Lower row: samples of the true surface, coloured by their distance to the
    cloud: what is missing shows dark. Parallel projection.

    ``run``: a mission's directory with ``cleaned.ply``; ``rock`` as for `the_rock`. ``UserError`` where a file is missing or
    the rock is unknown.
    """
    config, result, store = mission_config(run), MissionResult.load(run), Store()
    cloud = read_ply(run / "cleaned.ply").points_m
    if len(cloud) == 0:
        raise UserError(f"{run / 'cleaned.ply'} holds no points")
    subject = buried_rock(the_rock(run, result, rock, store), config)
    places, cloud_normals = RayCaster(subject.vertices_m, subject.faces).nearest(cloud)
    wrong_mm = 1000 * np.linalg.norm(cloud - places, axis=1)
    # The same samples as the metrics: same count, same seed.
    samples, normals = sample_surface(subject.vertices_m, subject.faces, config.evaluation.gt_samples, 0)
    missing_mm = 1000 * nearest_neighbours(cloud, samples)[0]
    shades = LinearSegmentedColormap.from_list("error", ["#cfe8f7", SKY, BLUE, ORANGE, VERMILION, "#3a0f00"])
    rows = (
        (
            cloud,
            cloud_normals,
            wrong_mm,
            "distance of the cloud to the true surface (mm)",
            CLOUD_ERROR_RANGE_MM,
        ),
        (samples, normals, missing_mm, "distance of the truth to the cloud (mm)", MISSING_RANGE_MM),
    )
    with look():
        figure = new_figure(9.4, 7.4)
        axes = figure.subplots(2, 2, sharex=True, sharey=True)
        for row, (points, facing, error_mm, unit, span_mm) in zip(axes, rows):
            for ax, (side, azimuth_deg) in zip(row, _SIDES.items()):
                right, up, towards = _camera_axes(azimuth_deg)
                # A point is drawn on the side that its surface faces, so that the back does not shine through.
                seen = np.flatnonzero(facing @ towards > 0)
                seen = seen[thin_indices(len(seen), MAX_CLOUD_POINTS)]
                seen = seen[np.argsort(points[seen] @ towards, kind="stable")]  # far points first
                centred = points[seen] - np.array(config.target_m)
                dots = ax.scatter(
                    centred @ right,
                    centred @ up,
                    c=error_mm[seen],
                    cmap=shades,
                    vmin=0,
                    vmax=span_mm,
                    s=3,
                    linewidths=0,
                    rasterized=True,
                )
                ax.set(title=f"from {side}", xlabel="right of target (m)", ylabel="above target (m)")
                ax.set_aspect("equal")
                ax.label_outer()
            figure.colorbar(dots, ax=list(row), label=unit, shrink=0.85, extend="max")
        figure.suptitle(
            f"{run.name}: {len(cloud):,} points; {100 * np.mean(missing_mm < 48):.0f} % of the whole true surface within "
            f"48 mm of the cloud, median error of the cloud {np.median(wrong_mm):.1f} mm",
            fontsize=10,
        )
        return figure


def _camera_axes(azimuth_deg: float) -> tuple[Floats, Floats, Floats]:
    """Right, up and towards-the-camera unit vectors of an orthographic view from that side."""
    a, e = np.deg2rad(azimuth_deg), np.deg2rad(_ELEVATION_DEG)
    towards = np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])
    right = np.array([-np.sin(a), np.cos(a), 0.0])
    return right, np.cross(towards, right), towards
