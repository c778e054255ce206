"""The authors' way on the photographs of one of our missions: the whole model rebuilt after every capture.

    OMP_NUM_THREADS=1 python -m research.paper_way [--rock boulder] [--preset paper-reduced] [--every 1] [--out FILE.json]

Our mission is flown three times, each in a fresh process on one thread: with nothing cached; with a warm store
that has every photograph, feature set, pair and seed model but has not seen this sequence of views; and with a
store that has seen this very sequence. Then the authors' pipeline runs on the same photographs, on one thread
too: COLMAP's own `feature_extractor` (16,384 features, a self-calibrated PINHOLE camera per image),
`exhaustive_matcher` and `mapper` (50 iterations of global adjustment, 4 px), with files and a database; features
and matches of earlier images stay in the database, as in their code; the model is rebuilt from scratch after the
seeds and after every capture. Then our dense stage and evaluation, on their poses (photographs resampled from
their focal lengths to the mission's). A last rebuild with the known camera shows what self-calibration costs.

With ``--every N`` features and matching are still run for every capture but the model is rebuilt only for every
N-th, the first and the last; the mapping times between are interpolated linearly (trapezoid). The output says so.

Seconds are CPU seconds (user + system, all threads) unless they say "wall"; photographs are not charged to the
authors' way, but are to ours.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from pathlib import Path

# isort: off
import cv2
import pycolmap
# isort: on

import numpy as np

from nbv.cache import Store
from nbv.config import MissionConfig, preset
from nbv.dense import PosedViews, dense_cloud
from nbv.errors import MissionFailure
from nbv.evaluation import evaluate_cloud
from nbv.flight import Flight
from nbv.photogrammetric.simulated_camera import SimulatedCamera
from nbv.rocks import Rock, load_rock
from nbv.scene import build_scene, make_renderer
from nbv.sparse.alignment import align_cameras
from nbv.sparse.colmap import camera_from_model_poses, camera_from_world_poses, registered_names
from nbv.threads import limit_threads
from nbv.types import Capture, Floats
from nbv.viewpoints import raw_candidates, seed_viewpoints
from research.fresh_process import Flown, fly_in_fresh_process, forget_sequences

pycolmap.logging.minloglevel = 2  # each extraction would warn about every image that it skips

MAX_FEATURES = 16384
GLOBAL_BA_ITERATIONS = 50
FILTER_REPROJECTION_PX = 4.0
METRICS = ("f_score_48mm", "completeness_48mm", "accuracy_48mm", "f_score_16mm", "c2c_mean_mm")


def photographs(config: MissionConfig, rock: Rock, replicate: int, chosen: list[str]) -> list[Capture]:
    """The captures of a flown mission, from the store: seeds, then the candidates ``chosen``."""

    def no_renderer(camera):  # type: ignore[no-untyped-def]
        return make_renderer(build_scene(rock, config.scene, camera, store=Store()), config.scene.backend)

    studio = SimulatedCamera(no_renderer, rock, replicate, config, Store())
    flight = Flight(config, rock_sha256=rock.sha256, replicate=replicate)
    candidates = {view.id: view for view in raw_candidates(config)}
    flight.take_off()
    views = [*seed_viewpoints(config), *(candidates[name] for name in chosen)]
    return [studio.take_photograph(view, flight.fly_to(view), flight.flight_time_s) for view in views]


class AuthorsReconstruction:
    """COLMAP's automatic stages on a folder of images and a database, one thread."""

    def __init__(self, folder: Path, camera: str = "") -> None:
        self.folder = folder
        self.images = folder / "images"
        self.images.mkdir(parents=True)
        self.database = folder / "database.db"
        self.camera = camera  # known parameters of one shared camera; "": a self-calibrated camera per image
        self.seconds: dict[str, list[float]] = {"features": [], "matching": []}

    def take_in(self, captures: list[Capture]) -> None:
        """Write the images, extract their features, match every pair that is not in the database yet."""
        for capture in captures:
            cv2.imwrite(str(self.images / capture.name), np.ascontiguousarray(capture.image[..., ::-1]))
        extraction = pycolmap.FeatureExtractionOptions()
        extraction.sift.max_num_features = MAX_FEATURES
        extraction.num_threads, extraction.use_gpu = 1, False
        reader = pycolmap.ImageReaderOptions()
        reader.camera_model, reader.camera_params = "PINHOLE", self.camera
        started = time.process_time()
        pycolmap.extract_features(
            self.database,
            self.images,
            camera_mode=pycolmap.CameraMode.SINGLE if self.camera else pycolmap.CameraMode.AUTO,
            reader_options=reader,
            extraction_options=extraction,
            device=pycolmap.Device.cpu,
        )
        extracted = time.process_time()
        matching = pycolmap.FeatureMatchingOptions()
        matching.num_threads, matching.use_gpu = 1, False
        verification = pycolmap.TwoViewGeometryOptions()
        verification.ransac.num_threads = 1
        pycolmap.match_exhaustive(
            self.database,
            matching_options=matching,
            verification_options=verification,
            device=pycolmap.Device.cpu,
        )
        self.seconds["features"].append(extracted - started)
        self.seconds["matching"].append(time.process_time() - extracted)

    def rebuild(self) -> tuple[pycolmap.Reconstruction, float]:
        """The best model (most registered images), built from scratch, and the CPU seconds it took."""
        options = pycolmap.IncrementalPipelineOptions()
        options.num_threads = 1
        options.ba_global_max_num_iterations = GLOBAL_BA_ITERATIONS
        options.mapper.filter_max_reproj_error = FILTER_REPROJECTION_PX
        if self.camera:
            options.ba_refine_focal_length = options.ba_refine_extra_params = False
        started = time.process_time()
        with tempfile.TemporaryDirectory(dir=self.folder) as out:
            models = pycolmap.incremental_mapping(self.database, self.images, out, options)
        if not models:
            raise SystemExit("COLMAP found no model; try another rock")
        return max(models.values(), key=lambda m: m.num_reg_images()), time.process_time() - started


def outcome(
    model: pycolmap.Reconstruction, captures: list[Capture], config: MissionConfig, rock: Rock
) -> dict[str, float]:
    """Our alignment, dense stage and evaluation on a COLMAP model whose cameras may have focal lengths of their own."""
    by_name = {capture.name: capture for capture in captures}
    names = registered_names(model)
    started = time.process_time()
    alignment = align_cameras(
        camera_from_model_poses(model), np.array([by_name[n].camera_from_world for n in names]), np.inf
    )
    poses = camera_from_world_poses(camera_from_model_poses(model), alignment.world_from_model)
    images = {}
    for image_id, name in zip(sorted(model.reg_image_ids()), names):
        fx, fy, cx, cy = model.image(image_id).camera.params
        images[name] = to_known_camera(by_name[name].image, (fx, fy, cx, cy), config)
    points_m = alignment.world_from_model.apply(np.array([p.xyz for p in model.points3D.values()]))
    posed = PosedViews(images, dict(zip(names, poses)), config.camera, config.target_m, config.dense)
    cloud = dense_cloud(posed, points_m)
    dense_s = time.process_time() - started
    metrics = evaluate_cloud(cloud, rock, config, Store()).metrics["observable"]
    return {
        "registered": len(names),
        "alignment_rms_m": alignment.rms_m,
        "median_focal_px": float(np.median([model.image(i).camera.params[0] for i in model.reg_image_ids()])),
        "dense_s": dense_s,
        "evaluation_s": time.process_time() - started - dense_s,
        **{name: metrics[name] for name in METRICS},
    }


def to_known_camera(
    image: np.ndarray, intrinsics: tuple[float, float, float, float], config: MissionConfig
) -> np.ndarray:
    """The photograph as the mission's camera would have taken it from the same pose (bilinear)."""
    fx, fy, cx, cy = intrinsics
    camera = config.camera
    own = np.array([[fx, 0, cx - 0.5], [0, fy, cy - 0.5], [0, 0, 1]])
    known = np.array(
        [
            [camera.focal_px, 0, camera.width_px / 2 - 0.5],
            [0, camera.focal_px, camera.height_px / 2 - 0.5],
            [0, 0, 1],
        ]
    )
    if np.allclose(own, known, atol=1e-6):
        return image
    own_from_known: Floats = own @ np.linalg.inv(known)
    return cv2.warpPerspective(
        image,
        own_from_known,
        (camera.width_px, camera.height_px),
        flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
        borderMode=cv2.BORDER_REPLICATE,
    )


def mapping_seconds(measured: dict[int, float], captures: int) -> list[float]:
    """Seconds of the rebuild after 0 (the seeds), 1, ... ``captures`` captures, interpolated where not measured."""
    known = sorted(measured)
    return np.interp(range(captures + 1), known, [measured[k] for k in known]).tolist()


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--rock", default="boulder")
    parser.add_argument("--preset", default="paper-reduced")
    parser.add_argument("--budget", type=int, help="adaptive captures; default: the preset's")
    parser.add_argument("--every", type=int, default=1, help="rebuild for every N-th capture only")
    parser.add_argument("--out", type=Path)
    arguments = parser.parse_args()
    if arguments.every < 1:
        parser.error("--every must be 1 or more")
    config = preset(arguments.preset)
    if arguments.budget:
        config = config.with_values({"stop.adaptive_budget": arguments.budget})
    with tempfile.TemporaryDirectory(prefix="paper-way-") as folder:
        report = compare(config, arguments.rock, arguments.every, Path(folder))
    if arguments.out:
        arguments.out.write_text(json.dumps(report, indent=1))


def compare(config: MissionConfig, rock_name: str, every: int, folder: Path) -> dict[str, object]:
    """Both ways on one rock; prints as it goes and returns everything."""
    home = folder / "home"
    ours: dict[str, Flown] = {"cold": fly_in_fresh_process(config, rock_name, 0, home)}
    forget_sequences(home)
    ours["warm, new sequence"] = fly_in_fresh_process(config, rock_name, 0, home)
    ours["warm, known sequence"] = fly_in_fresh_process(config, rock_name, 0, home)
    for name, evaluated in ours.items():
        print(
            f"ours, {name}: {evaluated.cpu_s:.1f} s CPU, {evaluated.wall_s:.1f} s wall, peak {evaluated.peak_rss_mb:.0f} MB, "
            f"status {evaluated.result.status}",
            flush=True,
        )
    cold = ours["cold"].result
    if cold.status == "failed":
        raise SystemExit(f"our own mission failed ({cold.reason}); there is nothing to compare")
    same = all(evaluated.result.metrics == cold.metrics for evaluated in ours.values())
    print(f"all three with the same metrics, to the bit: {same}", flush=True)

    limit_threads()
    rock = load_rock(rock_name, Store())
    captures = photographs(config, rock, 0, [record.chosen for record in cold.trace])
    n_seeds = len(captures) - len(cold.trace)
    authors = AuthorsReconstruction(folder / "authors")
    mapping: dict[int, float] = {}
    model = None
    for k in range(len(cold.trace) + 1):
        authors.take_in(captures[:n_seeds] if k == 0 else [captures[n_seeds + k - 1]])
        note = ""
        if k % every == 0 or k in (1, len(cold.trace)):
            model, mapping[k] = authors.rebuild()
            note = f", mapping {mapping[k]:.1f} s, {model.num_reg_images()} of {n_seeds + k} registered"
        print(
            f"authors' way, capture {k}: features {authors.seconds['features'][-1]:.1f} s, "
            f"matching {authors.seconds['matching'][-1]:.1f} s{note}",
            flush=True,
        )
    assert model is not None
    theirs = {"their cameras": outcome(model, captures, config, rock)}
    camera = config.camera
    known = AuthorsReconstruction(
        folder / "known", f"{camera.focal_px},{camera.focal_px},{camera.width_px / 2},{camera.height_px / 2}"
    )
    known.take_in(captures)
    try:
        theirs["known camera"] = outcome(known.rebuild()[0], captures, config, rock)
    except MissionFailure as failure:
        print(f"rebuild with the known camera: {failure.message}")

    stages = {**authors.seconds, "mapping": mapping_seconds(mapping, len(cold.trace))}
    per_capture = [sum(values) for values in zip(*stages.values())]
    last = theirs["their cameras"]
    total = sum(per_capture) + last["dense_s"] + last["evaluation_s"]
    measured = (
        "every rebuild measured"
        if every == 1
        else (
            f"{len(mapping)} of {len(cold.trace) + 1} rebuilds measured, the others interpolated (trapezoid)"
        )
    )
    print(f"\nauthors' way, {n_seeds} + {len(cold.trace)} captures of {rock_name} ({measured}):")
    print(
        f"  seeds {per_capture[0]:.1f} s; captures {sum(per_capture[1:]):.1f} s (first {per_capture[1]:.1f}, last "
        f"{per_capture[-1]:.1f}); dense {last['dense_s']:.1f} s; evaluation {last['evaluation_s']:.1f} s; "
        f"total {total:.1f} s"
    )
    print("\n| ours | CPU s | wall s | authors' CPU s / ours |\n|---|---|---|---|")
    for name, evaluated in ours.items():
        print(f"| {name} | {evaluated.cpu_s:.1f} | {evaluated.wall_s:.1f} | {total / evaluated.cpu_s:.1f} |")
    taking = sum(cold.timings_s.get(stage, 0.0) for stage in ("photograph", "scene"))
    print(f"\nOf our cold mission {taking:.1f} s is rendering, which the authors' way is not charged for.")
    print(
        "\n| outcome, observable surface | ours | authors', their cameras | authors' mapper, known camera |\n|---|---|---|---|"
    )
    for name in METRICS:
        print(
            f"| {name} | {cold.metrics['observable'][name]:.2f} | {theirs['their cameras'][name]:.2f} | "
            f"{theirs.get('known camera', {}).get(name, float('nan')):.2f} |"
        )
    for name in ("registered", "alignment_rms_m", "median_focal_px"):
        print(
            f"| {name} |  | {theirs['their cameras'][name]:.3f} | "
            f"{theirs.get('known camera', {}).get(name, float('nan')):.3f} |"
        )
    return {
        "rock": rock_name,
        "preset": config.preset,
        "seeds": n_seeds,
        "captures": len(cold.trace),
        "every": every,
        "authors_s": {"per_capture": per_capture, **stages, "mapping_measured": mapping, "total": total},
        "ours": {
            name: {
                "cpu_s": f.cpu_s,
                "wall_s": f.wall_s,
                "peak_rss_mb": f.peak_rss_mb,
                "timings_s": f.result.timings_s,
                "capture_cpu_s": f.capture_cpu_s,
                "metrics": {m: f.result.metrics["observable"][m] for m in METRICS},
            }
            for name, f in ours.items()
        },
        "authors_outcome": theirs,
        "same_bits": same,
    }


if __name__ == "__main__":
    main()
