"""The README's picture: one held-out rock at the paper's values and at the tuned ones.

gatetune campaign run --quick --name tune    # what `make tune` runs; it recommends the values below
gatetune mission run --rock mushroom --set dense.agreeing_views=3 --out runs/mushroom-paper
gatetune mission run --rock mushroom --set dense.agreeing_views=3 --set PATH=VALUE ... --out runs/mushroom-tuned
python -m research.working_picture --rock mushroom runs/mushroom-paper runs/mushroom-tuned
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.image import imread
from PIL import Image
from scipy.spatial import cKDTree

from nbv.mission.planning_state import load_state
from nbv.mission.run_directory import read_ply
from nbv.rocks import load_rock
from tuner.report.style import BLUE, VERMILION, look, new_figure

MISSING_RANGE_MM = 80.0
SAMPLES = 200_000
# As much missing as the paper's larger threshold allows is dark.
COLOURS = LinearSegmentedColormap.from_list("missing", ["#dcdcdc", "#c9b79c", VERMILION, "#5a1e00"])


def surface_samples(name: str) -> tuple[np.ndarray, np.ndarray]:
    """(S, 3) points of the true surface and their (S, 3) normals."""
    rock = load_rock(name)
    corners = rock.vertices_m[rock.faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    areas = np.linalg.norm(normals, axis=1)
    rng = np.random.default_rng(0)
    face = rng.choice(len(areas), SAMPLES, p=areas / areas.sum())
    u, v = np.sqrt(rng.random((1, SAMPLES))).T, rng.random((SAMPLES, 1))
    a, b, c = corners[face].transpose(1, 0, 2)
    return (1 - u) * a + u * (1 - v) * b + u * v * c, normals[face] / areas[face, None]


def views(run: Path) -> np.ndarray:
    """(N, 3) positions of the seeds, then of the views that were chosen."""
    state, pool = load_state(sorted((run / "states").glob("*.npz"))[-1])
    last = json.loads((run / "mission.json").read_text())["trace"][-1]["chosen"]
    return np.array([*state.visited_m, pool.viewpoint(pool.ids.index(last)).position_m])


def main() -> None:
    """Draw the picture."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("runs", type=Path, nargs=2, help="missions at the paper's and at the tuned values")
    parser.add_argument("--rock", required=True)
    parser.add_argument("--azimuth-deg", type=float, default=30.0, help="from where the surface is shown")
    parser.add_argument("--out", type=Path, default=Path("docs/images/working.png"))
    args = parser.parse_args()
    points, normals = surface_samples(args.rock)
    azimuth, elevation = np.deg2rad(args.azimuth_deg), np.deg2rad(10.0)
    right = np.array([-np.sin(azimuth), np.cos(azimuth), 0.0])
    toward = np.array(
        [np.cos(azimuth) * np.cos(elevation), np.sin(azimuth) * np.cos(elevation), np.sin(elevation)]
    )
    up = np.cross(toward, right)
    front = normals @ toward > 0
    order = np.flatnonzero(front)[np.argsort(points[front] @ toward)]
    with look():
        figure = new_figure(12.0, 3.2)
        photo, side, *surfaces = figure.subplots(1, 4, gridspec_kw={"width_ratios": [1.3, 1.3, 1, 1]})
        photo.imshow(imread(sorted((args.runs[1] / "images").glob("*.png"))[-1]))
        photo.set_title("a photograph of the simulated flight")
        photo.axis("off")
        paper, tuned = (views(run) for run in args.runs)
        edge = {"mec": "black", "mew": 0.5}
        side.plot(paper @ right, paper[:, 2], "^", color=VERMILION, ms=5, label="paper's plan", **edge)
        side.plot(tuned @ right, tuned[:, 2], "o", color=BLUE, ms=5, label="tuned", **edge)
        side.plot((points @ right)[::60], points[::60, 2], ",", color="#8d8d8d")
        side.set_aspect("equal")
        side.set_ylim(0, 4.2)
        side.set_xlabel("m")
        side.set_title("where they were taken")
        side.legend(
            loc="upper center", bbox_to_anchor=(0.5, -0.3), ncols=3, handletextpad=0.1, columnspacing=0.8
        )
        counts = [f"paper: {len(paper)} photographs", f"tuned: {len(tuned)} photographs"]
        for axes, run, title in zip(surfaces, args.runs, counts):
            metrics = json.loads((run / "mission.json").read_text())["metrics"]["observable"]
            missing_mm = 1000.0 * cKDTree(read_ply(run / "cleaned.ply").points_m).query(points)[0]
            shown = axes.scatter(
                points[order] @ right,
                points[order] @ up,
                c=missing_mm[order],
                s=0.8,
                lw=0,
                cmap=COLOURS,
                vmin=0.0,
                vmax=MISSING_RANGE_MM,
            )
            axes.set_aspect("equal")
            axes.axis("off")
            axes.set_title(f"{title}\nF-score {metrics['f_score_48mm']:.1f} %")
        bar = figure.colorbar(shown, ax=surfaces, extend="max", fraction=0.04, pad=0.02, shrink=0.8)
        bar.set_label("missing: distance to cloud (mm)")
        for axes in (photo, *surfaces):
            axes.set_anchor("N")
        figure.savefig(args.out, dpi=130, bbox_inches="tight")
    # A palette takes a quarter of the space.
    Image.open(args.out).convert("RGB").quantize(
        256, Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE
    ).save(args.out, optimize=True)
    print(f"written: {args.out}")


if __name__ == "__main__":
    main()
