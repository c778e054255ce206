"""Time and repeatability of the rendering backends, in one run on one rock.

    python -m research.render_backends [--rock NAME] [--frames 12]

Every backend runs in two fresh processes, so "equal in two processes" compares their images bit for bit.
Agreement compares each backend's views with those of the first.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from nbv.cache import Store
from nbv.threads import limit_threads, single_thread_environment

single_thread_environment()

import numpy as np  # noqa: E402

from nbv.config import RENDERERS, CameraConfig, SceneConfig  # noqa: E402
from nbv.errors import UserError  # noqa: E402
from nbv.geometry.frames import look_at  # noqa: E402
from nbv.rocks import load_rock  # noqa: E402
from nbv.scene import build_scene, make_renderer  # noqa: E402

TARGET = np.array([0.0, 0.0, 0.8])


def poses(count: int) -> list[np.ndarray]:
    """Views like a mission's: 3.5 to 4 m away, 10 to 55 degrees up, all around."""
    out = []
    for i in range(count):
        azimuth, elevation = np.radians(i * 360 * 0.382), np.radians(10 + 45 * ((i * 0.618) % 1))
        outward = np.array(
            [np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)]
        )
        out.append(look_at(TARGET + (3.5 if i % 2 else 4.0) * outward, TARGET))
    return out


def measure(rock_name: str, backend: str, frames: int, out: Path) -> None:
    """One process's measurements, as JSON in ``out`` with the views beside it."""
    limit_threads()
    started = time.perf_counter()
    rock = load_rock(rock_name, Store())
    loaded = time.perf_counter()
    scene = build_scene(rock, SceneConfig(), CameraConfig(), store=Store())
    built = time.perf_counter()
    try:
        renderer = make_renderer(scene, backend)
        renderer.render(poses(1)[0])
    except UserError as error:
        out.write_text(json.dumps({"error": str(error)}))
        return
    ready = time.perf_counter()
    wall, cpu, views = [], [], []
    for pose in poses(frames):
        w, c = time.perf_counter(), time.process_time()
        views.append(renderer.render(pose))
        wall.append(time.perf_counter() - w)
        cpu.append(time.process_time() - c)
    again = renderer.render(poses(1)[0])
    np.savez(
        out.with_suffix(".npz"),
        rgb=np.stack([v.rgb for v in views]),
        depth=np.stack([v.depth_m for v in views]),
        mask=np.stack([v.rock_mask for v in views]),
    )
    out.write_text(
        json.dumps(
            {
                "faces": len(rock.faces),
                "rock_s": loaded - started,
                "scene_s": built - loaded,
                "ready_s": ready - built,
                "wall_s": statistics.median(wall),
                "cpu_s": statistics.median(cpu),
                "repeats": bool(np.array_equal(again.rgb, views[0].rgb)),
                "digest": hashlib.sha256(b"".join(v.rgb.tobytes() for v in views)).hexdigest(),
            }
        )
    )


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--rock", default="boulder")
    parser.add_argument("--frames", type=int, default=12)
    parser.add_argument("--child", nargs=2, metavar=("BACKEND", "OUT"), help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.child:
        measure(args.rock, args.child[0], args.frames, Path(args.child[1]))
        return

    camera = CameraConfig()
    print(
        f"rock {args.rock}, {camera.width_px}x{camera.height_px}, {args.frames} frames, one thread; medians\n"
    )
    print(
        "| backend | wall s/frame | CPU s/frame | renderer and first frame s | scene s, 1st process / 2nd "
        "| repeats in a process | equal in two processes |"
    )
    print("|---|---|---|---|---|---|---|")
    with tempfile.TemporaryDirectory() as folder:
        views = {}
        for backend in RENDERERS:
            runs = []
            for attempt in range(2):
                out = Path(folder) / f"{backend}{attempt}.json"
                command = [sys.executable, __file__, "--rock", args.rock, "--frames", str(args.frames)]
                subprocess.run([*command, "--child", backend, str(out)], check=True)
                runs.append(json.loads(out.read_text()))
            if "error" in runs[0]:
                print(f"| {backend} | {runs[0]['error']} |")
                continue
            a, b = runs
            print(
                f"| {backend} | {min(a['wall_s'], b['wall_s']):.3f} | {min(a['cpu_s'], b['cpu_s']):.3f} "
                f"| {b['ready_s']:.2f} | {a['scene_s']:.2f} / {b['scene_s']:.2f} "
                f"| {'yes' if a['repeats'] and b['repeats'] else 'NO'} "
                f"| {'yes' if a['digest'] == b['digest'] else 'NO'} |"
            )
            with np.load(Path(folder) / f"{backend}0.npz") as archive:
                views[backend] = {name: archive[name] for name in archive.files}
        if len(views) < 2:
            return
        first, *others = views
        print(
            f"\n| backend against {first} | silhouette IoU, worst | relative depth error, median / 95 % "
            "| grey levels, mean absolute |\n|---|---|---|---|"
        )
        for other in others:
            a_view, b_view = views[first], views[other]
            overlap = (a_view["mask"] & b_view["mask"]).sum((1, 2)) / (a_view["mask"] | b_view["mask"]).sum(
                (1, 2)
            )
            both = (a_view["mask"] == b_view["mask"]) & (a_view["depth"] < 20) & (b_view["depth"] < 20)
            error = np.abs(a_view["depth"][both] - b_view["depth"][both]) / a_view["depth"][both]
            grey = np.abs(a_view["rgb"].astype(float) - b_view["rgb"]).mean()
            print(
                f"| {other} | {overlap.min():.4f} | {np.median(error):.1e} / {np.percentile(error, 95):.1e} "
                f"| {grey:.2f} |"
            )


if __name__ == "__main__":
    main()
