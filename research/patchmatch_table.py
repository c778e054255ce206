"""What COLMAP's PatchMatch makes of the same photographs: its settings on three rocks, and plans on six, beside SGBM.

    python -m research.patchmatch_table photograph MISSIONS --rock slab --plan hyb_h     # missions with SGBM, 15 s each
    python -m research.patchmatch_table match MISSIONS CLOUDS --rows default "radius 3"  # where a card is, 4 to 35 s a row
    python -m research.patchmatch_table measure MISSIONS CLOUDS > OUT.csv                # against the true rocks
    python -m research.patchmatch_table tell OUT.csv

20 photographs in `indoors`, replicate 0; ``photograph`` wants a ``GATETUNE_HOME`` without these missions. ``match`` needs
`nbv.dense` alone, so that it runs where little is installed; its processes share the card as missions do. Photographs are
kept in grey, which is all that both matchers use.
"""

from __future__ import annotations

import argparse
import csv
import json
import sys
import time
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import msgspec
import numpy as np

from nbv.config import CameraConfig, DenseConfig
from nbv.dense import PosedViews, patchmatch
from nbv.dense.reconstruct import dense_cloud
from nbv.types import PointCloud

_BEFORE: dict[str, Any] = {"patchmatch_draws": 15, "filter": True}  # what the rows were measured with
_COLMAPS = {"consistency_relative_depth": 0.01, "consistency_px": 2.0}
ROWS: dict[str, dict[str, Any]] = {
    "default": {},
    "before": _BEFORE,
    "no filter": {**_BEFORE, "filter": False},
    "1 confirming source": {**_BEFORE, "filter_min_num_consistent": 1},
    "3 confirming sources": {**_BEFORE, "filter_min_num_consistent": 3},
    "correlation 0.05": {**_BEFORE, "filter_min_ncc": 0.05},
    "correlation 0.2": {**_BEFORE, "filter_min_ncc": 0.2},
    "8 draws": {**_BEFORE, "patchmatch_draws": 8},
    "8 draws, 2 iterations": {**_BEFORE, "patchmatch_draws": 8, "patchmatch_iterations": 2},
    "2 iterations": {**_BEFORE, "patchmatch_iterations": 2},
    "5 iterations, 12 sources": {**_BEFORE, "patchmatch_iterations": 5, "patchmatch_sources": 12},
    "4 sources": {**_BEFORE, "patchmatch_sources": 4},
    "8 sources": {**_BEFORE, "patchmatch_sources": 8},
    "pairs to 60 degrees, 8 sources": {**_BEFORE, "max_pair_angle_deg": 60.0, "patchmatch_sources": 8},
    "radius 3": {**_BEFORE, "patchmatch_window_radius_px": 3},
    "radius 7": {**_BEFORE, "patchmatch_window_radius_px": 7},
    "window step 1": {**_BEFORE, "patchmatch_window_step_px": 1},
    "480 px": {**_BEFORE, "max_size_px": 480},
    "320 px": {**_BEFORE, "max_size_px": 320},
    "COLMAP's limits": _COLMAPS,  # not run yet, nor the next two
    "6 agreeing views": {"agreeing_views": 6},
    "6 agreeing views, COLMAP's limits": {**_COLMAPS, "agreeing_views": 6},
}
PLANS, FIRST = ("hyb_h", "orbit_15", "predicted_15"), "orbit_15"
_RESOLUTION_M = 5e-4  # of kept clouds
_FIELDS = ("rock", "plan", "row", "card_s", "f_score_48mm", "f_score_16mm", "accuracy_48mm", "accuracy_16mm")


def config_of(plan: str) -> Any:
    """What ``make tune`` would run: ``hyb_h`` and ``predicted`` with 12 seeds and 8 views, the latter on a ring; else an orbit."""
    from nbv.config import load_conditions, preset, under
    from tuner.campaign.settings_file import QUICK
    from tuner.problem.baselines import BASELINES, ONE_RING

    base, (kind, _, elevation) = preset("campaign").with_values(QUICK["overrides"]), plan.partition("_")
    config = base.with_values(BASELINES["hyb-h"].values)
    if plan != "hyb_h":
        ring = {**ONE_RING, "seed.lowest_deg": float(elevation), "sparse.min_registered_seeds": 6}
        config = BASELINES["orbit"].orbit(base, 20 if kind == "orbit" else 12).with_values(ring)
    if kind == "predicted":
        config = config.with_values(
            {**BASELINES["predicted"].values, "gate.kind": kind, "photographs": base.photographs}
        )
    return under(config, load_conditions(["indoors"])[0])


def photograph(folder: Path, rocks: list[str], plans: list[str]) -> None:
    """Keep what the dense stage of each mission is given."""
    from nbv.photogrammetric import reconstructor, run_photogrammetric_mission

    folder.mkdir(parents=True, exist_ok=True)
    for rock, plan in ((rock, plan) for rock in rocks for plan in plans):
        target = folder / f"{rock}.{plan}.npz"

        def keep(views: PosedViews, points_m: Any = None, target: Path = target) -> PointCloud:
            names = sorted(set(views.images) & set(views.camera_from_world))
            facts = {
                "names": names,
                "camera": msgspec.to_builtins(views.camera),
                "dense": msgspec.to_builtins(views.config),
                "target": [float(x) for x in views.target],
            }
            lossless = [cv2.IMWRITE_WEBP_QUALITY, 101]
            pictures = {
                f"picture_{i}": cv2.imencode(".webp", views.grey[n], lossless)[1] for i, n in enumerate(names)
            }
            poses = np.stack([views.camera_from_world[n] for n in names])
            np.savez(target, facts=json.dumps(facts), poses=poses, **pictures)
            return dense_cloud(views, points_m)

        if not target.exists():
            reconstructor.dense_cloud = keep  # type: ignore[attr-defined]
            run_photogrammetric_mission(config_of(plan), rock, 0)


def read(file: Path) -> PosedViews:
    """The views of a mission."""
    with np.load(file) as kept:
        facts = json.loads(str(kept["facts"]))
        grey = [cv2.imdecode(kept[f"picture_{i}"], cv2.IMREAD_GRAYSCALE) for i in range(len(facts["names"]))]
        images = {n: cv2.cvtColor(g, cv2.COLOR_GRAY2RGB) for n, g in zip(facts["names"], grey, strict=True)}
        poses = dict(zip(facts["names"], kept["poses"], strict=True))
    camera, dense = (
        msgspec.convert(facts[k], t) for k, t in (("camera", CameraConfig), ("dense", DenseConfig))
    )
    return PosedViews(images, poses, camera, facts["target"], dense)


def match_one(job: tuple[Path, str, str, Path]) -> str:
    """One row on one mission: its cloud, and the seconds on the card."""
    file, row, backend, target = job
    views, values, seconds = read(file), dict(ROWS[row]), [0.0]
    more = {name: values.pop(name) for name in [*values] if name.startswith("filter")}
    plain = patchmatch.patch_match

    def timed(workspace: Path, options: Any, free: patchmatch.Card) -> None:
        began = time.perf_counter()
        plain(workspace, {**options, **more}, free)
        seconds[0] = time.perf_counter() - began

    patchmatch.patch_match = timed  # type: ignore[attr-defined]
    cloud = dense_cloud(replace(views, config=replace(views.config, backend=backend, **values)))
    points = np.rint((cloud.points_m - views.target) / _RESOLUTION_M).astype(np.int16)
    np.savez_compressed(target, points=np.unique(points, axis=0), card_s=seconds[0])
    return f"{target.stem}: {seconds[0]:.1f} s on the card"


def match(folder: Path, out: Path, rows: list[str], backend: str, processes: int) -> None:
    """Every row on every mission of a folder that ``out`` lacks."""
    out.mkdir(parents=True, exist_ok=True)
    jobs = [
        (file, row, backend, out / f"{file.stem}.{row if backend == 'patchmatch' else backend}.npz")
        for row in rows
        for file in sorted(folder.glob("*.npz"))
    ]
    with ProcessPoolExecutor(processes) as pool:
        for said in pool.map(match_one, (job for job in jobs if not job[-1].exists())):
            print(said, flush=True)


def measure(folder: Path, clouds: Path) -> None:
    """Print what the clouds of a folder are worth, as CSV."""
    from nbv.evaluation import evaluate_cloud
    from nbv.rocks import load_rock

    table = csv.writer(sys.stdout, lineterminator="\n")
    table.writerow(_FIELDS)
    for file in sorted(clouds.glob("*.npz")):
        rock, plan, row = file.name.removesuffix(".npz").split(".", 2)
        with np.load(file) as kept:
            cloud = PointCloud(kept["points"] * _RESOLUTION_M + read(folder / f"{rock}.{plan}.npz").target)
            card_s = float(kept["card_s"])
        found = evaluate_cloud(cloud, load_rock(rock), config_of(plan)).metrics["observable"]
        table.writerow([rock, plan, row, f"{card_s:.1f}", *(f"{found[name]:.2f}" for name in _FIELDS[4:])])


def tell(path: Path) -> None:
    """Rows by rock for Hyb-H, then plans by rock and dense stage with the differences from `FIRST`."""
    from tuner.problem.intervals import mean_interval
    from tuner.report.labels import difference_text

    with path.open() as file:
        found = {(r["rock"], r["plan"], r["row"]): r for r in csv.DictReader(file)}
    rocks = [
        rock for rock in dict.fromkeys(rock for rock, _, _ in found) if (rock, "hyb_h", "radius 7") in found
    ]
    print(f"|Hyb-H, F 48 mm / F 16 mm|s|{'|'.join(rocks)}|\n|-|-:|{'-:|' * len(rocks)}")
    for row in (row for row in (*ROWS, "both passes", "sgbm") if any(key[2] == row for key in found)):
        own = [found.get((rock, "hyb_h", row)) for rock in rocks]
        card_s = np.mean([float(r["card_s"]) for r in own if r])
        cells = [f"{r['f_score_48mm']} / {r['f_score_16mm']}" if r else "" for r in own]
        print(f"|{row}|{card_s:.1f}|{'|'.join(cells)}|")
    rocks = list(dict.fromkeys(rock for rock, _, _ in found))
    print(f"\n|F 48 mm|{'|'.join(rocks)}|mean|from {FIRST}|\n|-|{'-:|' * (len(rocks) + 2)}")
    for row in ("before", "sgbm"):
        score = {k[:2]: float(r["f_score_48mm"]) for k, r in found.items() if k[2] == row}
        for plan in PLANS:
            own_scores = [score[rock, plan] for rock in rocks]
            gains = mean_interval({rock: [score[rock, plan] - score[rock, FIRST]] for rock in rocks})
            shown = "" if plan == FIRST else difference_text(gains, 2)
            print(
                f"|{row}, {plan}|{'|'.join(f'{s:.1f}' for s in own_scores)}|{np.mean(own_scores):.2f}|{shown}|"
            )


if __name__ == "__main__":
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    commands = parser.add_subparsers(required=True, dest="command")
    for name in ("photograph", "match", "measure", "tell"):
        command = commands.add_parser(name)
        command.add_argument("folder", type=Path)
        if name in ("match", "measure"):
            command.add_argument("clouds", type=Path)
    commands.choices["photograph"].add_argument("--rock", action="append", required=True)
    commands.choices["photograph"].add_argument("--plan", action="append", required=True)
    commands.choices["match"].add_argument("--rows", nargs="+", default=["default"], choices=[*ROWS])
    commands.choices["match"].add_argument("--backend", default="patchmatch")
    commands.choices["match"].add_argument("--processes", type=int, default=4)
    asked = parser.parse_args()
    if asked.command == "photograph":
        photograph(asked.folder, asked.rock, asked.plan)
    elif asked.command == "match":
        match(asked.folder, asked.clouds, asked.rows, asked.backend, asked.processes)
    elif asked.command == "measure":
        measure(asked.folder, asked.clouds)
    else:
        tell(asked.folder)
