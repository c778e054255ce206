"""How the cost of a capture grows: captures, image size, candidates, points, rocks; with fitted exponents.

    OMP_NUM_THREADS=1 python -m research.growth [--speed FILE.json] [--rocks boulder slab waist vesicular]
        [--figure docs/images/growth.png] [--out FILE.json]

The exponent p of ``cost ~ size ** p`` is the slope of a least-squares line through the logarithms; the last column is
the slope between the two largest sizes. CPU seconds, one thread; the smallest of several repeats where the same work
can be repeated.

- captures: planning, flight, photograph and update of every adaptive capture of a paper mission, against the
  photographs in the model. Taken from the output of ``mission_speed.py --parts captures``
  (``--speed``). With ``--missions`` the wall seconds that finished missions logged.
- image size: features of one photograph, matching of one pair, depth map of one view with 3 neighbours, against
  the number of pixels; campaign preset, the same four views rendered at each size.
- candidates, points: both rankings, on the first planning state of a campaign mission; the
  pool is drawn denser or thinner, the sparse points are drawn from the model's with a jitter of 5 mm.
- rocks: CPU seconds of campaign missions, one per rock, nothing cached, in one common store: the sum against the
  number of rocks.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import os
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2  # noqa: F401  before pycolmap
import numpy as np

from nbv.cache import Store
from nbv.config import preset
from nbv.dense import PosedViews
from nbv.dense.stereo import estimate_depth
from nbv.geometry.neighbours import knn_d95_m
from nbv.mission.planning_state import load_state
from nbv.photogrammetric.simulated_camera import SimulatedCamera
from nbv.rocks import load_rock
from nbv.scene import build_scene, make_renderer
from nbv.scorers import rank_candidates
from nbv.sparse.features import extract_features
from nbv.sparse.matching import match_pair, verify_pair
from nbv.threads import limit_threads
from nbv.types import PlanningState, SparseModel
from nbv.viewpoints import candidate_pool, seed_viewpoints
from research.fresh_process import run_in_fresh_process

Curve = dict[str, Any]


def fastest(function: Callable[[], object], repeats: int = 5) -> float:
    """Smallest CPU seconds of several calls, after one that is not counted."""
    function()
    found = []
    for _ in range(repeats):
        started = time.process_time()
        function()
        found.append(time.process_time() - started)
    return min(found)


def curve(name: str, what: str, sizes: list[float], seconds: list[float]) -> Curve:
    """Sizes, seconds and the fitted exponents."""
    x, y = np.log(sizes), np.log(seconds)
    slope = float(np.polyfit(x, y, 1)[0])
    last = float((y[-1] - y[-2]) / (x[-1] - x[-2]))
    return {"name": name, "size": what, "sizes": sizes, "seconds": seconds, "exponent": slope, "last": last}


def image_sizes(rock_name: str) -> list[Curve]:
    """Features, matching and depth against pixels."""
    pixels: list[float] = []
    costs: dict[str, list[float]] = {
        "features, a photograph": [],
        "matching, a pair": [],
        "depth map, a view": [],
    }
    rock = load_rock(rock_name, Store())
    for width in (320, 480, 640, 960):
        base = preset("campaign")
        scale = width / base.camera.width_px
        config = base.with_values(
            {
                "camera.width_px": width,
                "camera.height_px": round(480 * scale),
                "camera.focal_px": base.camera.focal_px * scale,
            }
        )
        renderer = make_renderer(
            build_scene(rock, config.scene, config.camera, store=Store()), config.scene.backend
        )
        studio = SimulatedCamera(lambda _, r=renderer: r, rock, 0, config)  # type: ignore[misc]
        views = seed_viewpoints(config)[:1]
        shots = [studio.take_photograph(views[0], np.array(views[0].position_m), 0.0)]
        # Neighbours as in a mission: 6 to 10 degrees beside.
        near = []
        for turn in (6.0, -8.0, 10.0):
            x, y, z = views[0].position_m
            c, s = np.cos(np.radians(turn)), np.sin(np.radians(turn))
            near.append(
                studio.take_photograph(
                    dataclasses.replace(views[0], id=f"near{turn:g}"),
                    np.array([c * x - s * y, s * x + c * y, z]),
                    0.0,
                )
            )
        image, other = shots[0].image, near[0].image
        assert image is not None and other is not None
        a, b = (extract_features(i, config.sparse) for i in (image, other))
        pixels.append(float(width * config.camera.height_px))
        costs["features, a photograph"].append(
            fastest(lambda i=image, c=config: extract_features(i, c.sparse), 3)
        )
        costs["matching, a pair"].append(
            fastest(
                lambda a=a, b=b, c=config: verify_pair(
                    a, b, match_pair(a.descriptors, b.descriptors, c.sparse.match_ratio), c.camera, c.sparse
                ),
                3,
            )
        )
        posed = PosedViews(
            {shot.name: shot.image for shot in shots + near if shot.image is not None},
            {shot.name: shot.camera_from_world for shot in shots + near},
            config.camera,
            config.target_m,
            config.dense,
        )
        _ = posed.grey
        names = [shot.name for shot in near]
        costs["depth map, a view"].append(
            fastest(lambda v=posed, s=shots[0].name, n=names: estimate_depth(v, s, n), 3)  # type: ignore[misc]
        )
    return [curve(name, "pixels", pixels, seconds) for name, seconds in costs.items()]


def resampled(model: SparseModel, count: int) -> SparseModel:
    """``count`` points drawn from the model's, moved by about 5 mm, with their tracks."""
    rng = np.random.default_rng(count)
    rows = rng.integers(len(model.points_m), size=count)
    lengths = model.track_lengths[rows]
    tracks = [model.track_cameras[model.track_offsets[i] : model.track_offsets[i + 1]] for i in rows]
    return dataclasses.replace(
        model,
        points_m=model.points_m[rows] + rng.normal(0, 0.005, (count, 3)),
        reprojection_error_px=model.reprojection_error_px[rows],
        track_offsets=np.concatenate([[0], np.cumsum(lengths)]),
        track_cameras=np.concatenate(tracks),
    )


def planning(state: PlanningState) -> list[Curve]:
    """Rankings against candidates and points."""
    config = preset("campaign")
    curves = []
    sizes, seconds = [], []
    for factor in (0.25, 0.5, 1, 2, 4, 8):
        dense = config.with_values(
            {
                "pool.lateral_count": round(120 * factor),
                "pool.upper_count": round(50 * factor),
                "pool.min_spacing_m": 0.0,
                "pool.max_candidates": 10_000,
            }
        )
        pool = candidate_pool(dense, state.vehicle_position_m, state.visited_m[state.n_seeds :])
        sizes.append(float(len(pool)))
        seconds.append(fastest(lambda p=pool, c=dense: rank_candidates(state, p, c)))
    curves.append(curve("rankings", "candidates", sizes, seconds))
    pool = candidate_pool(config, state.vehicle_position_m, state.visited_m[state.n_seeds :])
    sizes, seconds = [], []
    for count in (1000, 2000, 4000, 8000, 16000, 32000):
        sizes.append(float(count))
        costs = []
        for repeat in range(3):  # other points each time: neighbour distances are remembered per cloud
            varied = dataclasses.replace(state, model=resampled(state.model, count + repeat))
            started = time.process_time()
            knn_d95_m(varied.model.points_m, config)
            rank_candidates(varied, pool, config)
            costs.append(time.process_time() - started)
        seconds.append(min(costs))
    curves.append(curve("rankings and KNN", "points", sizes, seconds))
    return curves


def rocks_curve(home: Path, names: list[str]) -> Curve:
    """Sum over rocks of a cold campaign mission's cost."""
    costs = [run_in_fresh_process(preset("campaign"), name, 0, home).cpu_s for name in names]
    total = np.cumsum(costs).tolist()
    return curve(
        "campaign missions, nothing cached", "rocks", [float(n + 1) for n in range(len(names))], total
    )


def captures_curve(speed: Path) -> Curve:
    """Cost of a capture against photographs in the model."""
    report = json.loads(speed.read_text())
    costs = (report["ours"]["cold"] if "ours" in report else report["captures"])["capture_cpu_s"]
    return captures_in_blocks("a capture, paper preset", costs)


def captures_in_blocks(name: str, costs: list[float]) -> Curve:
    """Means of 5 captures, the interval of global adjustments, after 24 seeds."""
    blocks = [costs[k : k + 5] for k in range(0, len(costs) - 4, 5)]
    sizes = [24.0 + 5 * i + 3 for i in range(len(blocks))]
    return curve(name, "photographs", sizes, [float(np.mean(b)) for b in blocks])


def flown_captures_curve(folder: Path) -> Curve:
    """Wall seconds of planning and update by capture, median over the finished missions under ``folder``."""
    traces = [json.loads(f.read_text())["trace"] for f in sorted(folder.rglob("mission.json"))]
    longest = max(map(len, traces))
    costs = np.array([[r["update_s"] + r["planning_s"] for r in t] for t in traces if len(t) == longest])
    name = f"planning, update (wall, {len(costs)} missions)"
    return captures_in_blocks(name, np.median(costs, axis=0).tolist())


def draw(curves: list[Curve], path: Path) -> None:
    """One panel per kind of size, logarithmic axes."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt
    import matplotlib.ticker

    kinds = list(dict.fromkeys(c["size"] for c in curves))
    figure, axes = plt.subplots(
        1, len(kinds), figsize=(3.6 * len(kinds), 3.6), squeeze=False, layout="constrained"
    )
    for axis, kind in zip(axes[0], kinds):
        for item in (c for c in curves if c["size"] == kind):
            axis.loglog(
                item["sizes"],
                item["seconds"],
                "o-",
                markersize=3,
                linewidth=1,
                label=f"{item['name']}: p = {item['exponent']:.2f}",
            )
        axis.set_xlabel(kind)
        axis.set_ylabel("seconds")
        axis.grid(True, which="both", alpha=0.2)
        sizes = next(c["sizes"] for c in curves if c["size"] == kind)
        marks = [sizes[0], sizes[len(sizes) // 2], sizes[-1]]
        axis.set_xticks(marks, [f"{m:,.0f}" for m in marks])
        axis.xaxis.set_minor_formatter(matplotlib.ticker.NullFormatter())
        axis.set_ylim(top=axis.get_ylim()[1] * 2)
        axis.legend(fontsize=6.5, loc="upper left")
    figure.savefig(path, dpi=130)


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--rocks", nargs="*", default=["boulder", "slab", "waist", "vesicular"])
    parser.add_argument("--speed", type=Path, help="output of mission_speed.py")
    parser.add_argument(
        "--missions", type=Path, help="folder of finished missions: their captures, as logged"
    )
    parser.add_argument("--curves", type=Path, help="an earlier --out: add to it, measure nothing again")
    parser.add_argument("--figure", type=Path)
    parser.add_argument("--out", type=Path)
    arguments = parser.parse_args()
    curves = json.loads(arguments.curves.read_text()) if arguments.curves else measure(arguments.rocks)
    if arguments.speed:
        curves.insert(0, captures_curve(arguments.speed))
    if arguments.missions:
        curves.insert(0, flown_captures_curve(arguments.missions))
    print("| what | against | from | to | CPU s, smallest | CPU s, largest | exponent | last two |")
    print("|---|---|---|---|---|---|---|---|")
    for c in curves:
        print(
            f"| {c['name']} | {c['size']} | {c['sizes'][0]:g} | {c['sizes'][-1]:g} | {c['seconds'][0]:.3g} | "
            f"{c['seconds'][-1]:.3g} | {c['exponent']:.2f} | {c['last']:.2f} |"
        )
    if arguments.out:
        arguments.out.write_text(json.dumps(curves, indent=1))
    if arguments.figure:
        draw(curves, arguments.figure)


def measure(rocks: list[str]) -> list[Curve]:
    """All curves that this script measures itself."""
    with tempfile.TemporaryDirectory(prefix="growth-") as name:
        home = Path(name) / "home"
        os.environ["GATETUNE_HOME"] = str(home)
        limit_threads()
        curves = image_sizes(rocks[0])
        mission = Path(name) / "mission"
        short = preset("campaign").with_values({"stop.adaptive_budget": 1})
        run_in_fresh_process(short, rocks[0], 0, home, mission, keep="all")
        curves += planning(load_state(mission / "states" / "iter_00.npz")[0])
        if len(rocks) > 1:
            curves.append(rocks_curve(Path(name) / "empty", rocks))
    return curves


if __name__ == "__main__":
    main()
