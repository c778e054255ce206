"""Every parameter of a mission, changed: something is another, or it is refused by name; nothing is taken and ignored."""

import hashlib
import json
import re
from collections.abc import Callable, Iterator
from contextlib import nullcontext
from functools import cache
from operator import attrgetter
from pathlib import Path
from typing import Any

import numpy as np
import pycolmap
import pytest
from photographed_ball import spread, write_set
from refusals import refused
from scene_helpers import SMALL_GROUND, make_ball
from scoring_state import few_seeds

from nbv.cache import Store
from nbv.config import CameraConfig, MissionConfig, preset
from nbv.config.mission_config import parameters
from nbv.dense import patchmatch
from nbv.dense.patchmatch import Card
from nbv.errors import MissionFailure, UserError
from nbv.geometric.geometric_fidelity import GeometricFidelity
from nbv.mission.result import MissionResult
from nbv.photogrammetric.photogrammetric_fidelity import PhotogrammetricFidelity
from nbv.photographs.photograph_fidelity import PhotographFidelity
from nbv.process import Stopwatch
from nbv.scene import Renderer, build_scene, make_renderer
from nbv.types import PointCloud
from nbv.viewpoints import seed_viewpoints

NAMES = ("preset", "condition")  # what a configuration is called
CALLED = "gate.kind"
FEW = {"photographs": 27}
TURN = {"photographs": 18, **few_seeds(15)}
NOISY = {"telemetry.horizontal_noise_m": 0.1, "telemetry.vertical_noise_m": 0.1}
# Among what a parameter matters, and a value that does, where neither is plain.
BESIDE: dict[str, tuple[dict[str, Any], Any]] = {
    "dense.patchmatch_window_step_px": ({}, 1),
    "scene.sun_elevation_deg": ({}, 20.0),
    "wind.sway_s": ({"wind.gust_m_s": 0.5}, 0.5),
    "wind.mean_speed_m_s": ({}, 2.0),
    "flight.min_camera_altitude_m": ({"seed.ring_elevations_deg": [-6.0, 22.0, 29.0, 36.0]}, 0.35),
    "seed.ring_azimuth_counts": ({}, [7, 6, 6, 5]),
    "photographs": ({}, 25),
    "seeds": ({"sparse.ground_features": 2000}, 16),
    "seed.layout": (TURN, "rings"),
    "seed.lowest_deg": (TURN, 25.0),
    "seed.span_deg": ({**TURN, "seed.upper_share": 0.3}, 12.0),
    "seed.upper_share": (TURN, 0.3),
    "pool.min_altitude_m": ({}, 1.5),
    "pool.max_altitude_m": ({}, 1.4),
    "pool.max_travel_m": ({}, 2.0),
    "pool.revisit_exclusion_m": ({}, 3.0),
    "pool.azimuth_sectors": ({"pool.max_candidates": 12}, 3),
    "pool.max_candidates": ({}, 5),
    "stop.criterion": ({"stop.knn_threshold_m": 0.5}, "both"),
    "stop.knn_threshold_m": ({"stop.criterion": "both"}, 0.5),
    "stop.predicted_percent": ({"stop.criterion": "predicted"}, 99.99),
    "gate.oracle_coverage": ({CALLED: "hyb-o"}, "matchable"),
    "gate.oracle_samples": ({CALLED: "hyb-o"}, 150),
    "gate.oracle_threshold_m": ({CALLED: "hyb-o"}, 0.3),
    "gate.oracle_quality_weight": ({CALLED: "hyb-o"}, 5.0),
    "target.size_error_percent": ({"rock": "boulder-7"}, 50.0),
    "target.ground_m": ({CALLED: "predicted"}, 0.3),
    **{f"telemetry.{name}": (NOISY, value) for name, value in {
        "horizontal_noise_m": 0.2, "vertical_noise_m": 0.2, "drift_m": 0.1,
        "lever_arm_m": [0.1, 0.0, 0.0], "attitude_noise_deg": 1.0,
    }.items()},
    "sparse.first_octave": ({}, 1),
    "dense.max_size_px": ({}, 100),
    "telemetry.drift_time_s": ({"telemetry.drift_m": 0.1, **NOISY}, 50.0),
    "evaluation.floater_radius_m": ({}, 0.2),
    "sparse.min_inliers": ({}, 100_000),
    "dense.min_pair_angle_deg": ({}, 15.0),
    "shared.theta_min_deg": ({CALLED: "covis", "covis.weights.ang": 5.0}, 60.0),
    "covis.weights.ang": ({CALLED: "covis", "shared.theta_min_deg": 60.0}, 9.0),
    "b_aware.weights.ang": ({CALLED: "b-aware", "shared.theta_min_deg": 60.0}, 9.0),
    "predicted.weights.ang": ({CALLED: "predicted", "shared.theta_min_deg": 60.0}, 9.0),
}  # fmt: skip
OF_SCORER = {"covis": "covis", "b_aware": "b-aware", "predicted": "predicted"}


def other(path: str, value: Any) -> Any:
    """A value that is not the configured one."""
    declaration = parameters()[path]
    if declaration.choices:
        return next(choice for choice in declaration.choices if choice != value)
    if isinstance(value, bool):
        return not value
    if isinstance(value, tuple):
        return [x * 1.1 + 0.05 for x in value]
    if isinstance(value, int):
        return value * 2 + 3
    return value * 0.3 if value else 0.7


@cache
def mission(values: str) -> str:
    """The outcome of a geometric mission with these values."""
    given = json.loads(values)
    rock = given.pop("rock", "slab")
    return outcome(GeometricFidelity.run(preset("campaign").with_values(given), rock))


def outcome(result: MissionResult) -> str:
    """A mission's outcome, without times of the clock and what its files are called."""
    tree = json.loads(result.to_json())
    for name in ("timings_s", "provenance", "config_digest"):
        del tree[name]
    del tree["costs"]["wall_s"]
    return json.dumps(tree, sort_keys=True)


def scenario(
    path: str, base: dict[str, Any] = FEW, known: dict[str, tuple[dict[str, Any], Any]] = BESIDE
) -> tuple[dict[str, Any], Any]:
    beside, value = known.get(path, ({}, None))
    section = path.partition(".")[0]
    if section in OF_SCORER:
        beside = {CALLED: OF_SCORER[section], **beside}
    base = base | beside
    config = preset("campaign").with_values({k: v for k, v in base.items() if k != "rock"})
    return base, other(path, attrgetter(path)(config)) if value is None else value


# Without effect and not refused, since strategies and search spaces for all fidelities set them: these targets are certain,
# the distances of a set's photographs are what they are, and its dense stage searches near the sparse model.
WITHOUT_EFFECT = {
    GeometricFidelity: ("seed.recentre_after",),
    PhotographFidelity: ("seed.recentre_after", "seed.radius_m", "dense.search"),
}


def check(fidelity: type, fly: Callable[[str], str], path: str, base: dict[str, Any], value: Any) -> None:
    """Another outcome, or one of the refusals by name."""
    if path in WITHOUT_EFFECT.get(fidelity, ()):
        assert fly(json.dumps(base | {path: value})) == fly(json.dumps(base))
        return
    changed = json.dumps(base | {path: value})
    if path.startswith(tuple(fidelity.unnoticed)):
        refused(rf"{fidelity.name} missions take no notice of .*{path}", fly, changed)
        return
    before = fly(json.dumps(base))
    try:
        after = fly(changed)
    except UserError as error:
        assert re.search(rf"(?<![\w.]){re.escape(path)}\b", str(error)), f"{error} does not name {path}"
    else:
        assert after != before


@pytest.mark.slow
@pytest.mark.parametrize("path", [p for p in parameters() if p not in NAMES])
def test_a_geometric_mission_notices_it_or_refuses_it(path):
    check(GeometricFidelity, mission, path, *scenario(path))


# -- missions over photographs: the loop of all missions, with structure from motion and stereo --------------------

BALL = {
    "photographs": 18,
    "seeds": 15,
    "seed.layout": "turn",
    "seed.lowest_deg": 25.0,
    "dense.max_size_px": 160,
    "dense.fusion_voxel_m": 0.03,
    "dense.search": "sparse",
    "sparse.max_pairs": 6,
    "evaluation.gt_samples": 1000,
}
TAKEN = ("scene", "wind", "target", "target_m")  # in which no set can be photographed anew
UNSEEN = ("sparse.update_pairs", "dense.min_baseline_angle_deg")  # on a ball, from one distance
OF_SCORERS = ("shared", *OF_SCORER)  # what ranks views is the same as in a geometric mission
FEW_SEEDS = {"photographs": 8, "seeds": 5, "sparse.min_registered_seeds": 3, "sparse.ground_features": 2000}
RINGS = {"photographs": 27, "seeds": 24, "seed.layout": "rings"}
BESIDE_PHOTOGRAPHS: dict[str, tuple[dict[str, Any], Any]] = {
    "flight.keep_out_radius_m": ({"flight.keep_out_height_m": 9.0}, 3.0),
    "flight.keep_out_height_m": ({"flight.keep_out_radius_m": 3.0}, 9.0),
    "photographs": ({}, 16),
    "seeds": ({}, 16),
    "seed.layout": ({}, "rings"),
    "seed.ring_elevations_deg": (RINGS, [16.0, 22.0, 29.0, 15.0]),
    "seed.ring_azimuth_counts": (RINGS, [7, 6, 6, 5]),
    "seed.lowest_deg": ({}, 35.0),
    "pool.min_altitude_m": ({}, 2.4),
    "stop.knn_region": ({"stop.criterion": "both", "stop.knn_threshold_m": 0.32}, "all"),
    "stop.predicted_percent": ({"stop.criterion": "predicted"}, 50.0),
    "sparse.max_features": ({}, 300),
    "sparse.max_pairs": ({}, 3),
    "sparse.global_ba_interval": ({}, 1),
    "sparse.max_alignment_rms_m": ({}, 1e-4),
    **{f"dense.patchmatch_{name}": ({"dense.backend": "patchmatch"}, value) for name, value in {
        "sources": 2, "iterations": 1, "window_radius_px": 3, "window_step_px": 1, "draws": 4,
    }.items()},
    "dense.best_pair_angle_deg": ({"dense.neighbours": 1}, 25.0),
    "sparse.min_registered_seeds": (FEW_SEEDS, 4),
}  # fmt: skip


def what_is_asked_of_a_card(workspace: Path, options: dict[str, Any], card: Card) -> None:
    """Stands for CUDA: the mission ends, and its outcome says what COLMAP was to do."""
    sources = (workspace / "stereo" / "patch-match.cfg").read_text()
    raise MissionFailure("asked", f"{options} {sources}")


@pytest.fixture(scope="module")
def ball(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Callable[[str], str]]:
    """What a mission over rendered photographs of a ball has as its outcome."""
    home = tmp_path_factory.mktemp("home")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("GATETUNE_HOME", str(home))
        patch.setattr(pycolmap, "has_cuda", True)
        patch.setattr(patchmatch, "free_card", lambda: nullcontext(Card(0, "0")))
        patch.setattr(patchmatch, "patch_match", what_is_asked_of_a_card)
        write_set("ball", spread(32), rendered=True)
        store = Store(home / "store")

        @cache
        def fly(values: str) -> str:
            config = preset("campaign").with_values(json.loads(values))
            return outcome(PhotographFidelity.run(config, "ball", cache=store))

        yield fly


@pytest.mark.slow
@pytest.mark.parametrize(
    "path",
    [p for p in parameters() if p not in UNSEEN and p.split(".")[0] not in (*NAMES, *TAKEN, *OF_SCORERS)],
)
def test_a_mission_over_photographs_notices_it_or_refuses_it(path, ball):
    check(PhotographFidelity, ball, path, *scenario(path, BALL, BESIDE | BESIDE_PHOTOGRAPHS))


# -- missions with photographs: planned as geometric ones, reconstructed as those over photographs ----------------------


class SmallScene(PhotogrammetricFidelity):
    """A ball on a small ground, which is baked in a second."""

    load = staticmethod(lambda name, store: make_ball())

    def _renderer(self, camera: CameraConfig) -> Renderer:
        rock, config, store = self.context.rock, self.context.config.scene, self.context.store
        return make_renderer(build_scene(rock, config, camera, SMALL_GROUND, store), config.backend)


def scene(values: str) -> tuple[MissionConfig, SmallScene]:
    config = preset("campaign").with_values(json.loads(values))
    return config, SmallScene(SmallScene.prepare(config, "ball", 0, Store(), False, Stopwatch()))


@cache
def photographed(values: str) -> str:
    """A photograph and its telemetry."""
    config, fidelity = scene(values)
    view = seed_viewpoints(config)[0]
    capture = fidelity.camera.take_photograph(view, np.array(view.position_m), 60.0)
    assert capture.image is not None
    digest = hashlib.sha256(capture.image.tobytes()).hexdigest()
    return json.dumps([capture.image.shape, digest, capture.camera_from_world.tolist()])


@cache
def measured(values: str) -> str:
    """What is measured of a ball's surface on a tilted ground."""
    _, fidelity = scene(values)
    rng = np.random.default_rng(0)
    surface = rng.choice(fidelity.context.rock.vertices_m, 20_000)
    x, y = rng.uniform(-1.6, 1.6, (2, 5000))
    ground = np.column_stack([x, y, 0.03 * x + rng.normal(0, 0.01, 5000)])
    strays = rng.uniform([-2, -2, 0], [2, 2, 4], (300, 3))
    cloud = PointCloud(
        np.concatenate([surface + rng.normal(0, 0.01, surface.shape), ground, strays]), None, None
    )
    return json.dumps(fidelity.evaluate(cloud).metrics, sort_keys=True)


SMALL = {
    "camera.width_px": 160,
    "camera.height_px": 120,
    "camera.focal_px": 116.4,
    "dense.fusion_voxel_m": 0.03,
    "evaluation.gt_samples": 2000,
}
OF_THE_WORLD = ("camera", "scene", "sensor", "telemetry", "target", "evaluation")
MOVING = {
    "sensor.exposure_time_s": 0.02,
    "sensor.residual_speed_m_s": 0.5,
    "sensor.residual_rate_deg_s": 20.0,
}
BESIDE_SCENE: dict[str, tuple[dict[str, Any], Any]] = {
    "sensor.exposure_time_s": (MOVING, 0.1),
    "sensor.residual_speed_m_s": (MOVING, 2.0),
    "sensor.residual_rate_deg_s": (MOVING, 90.0),
    "evaluation.ground_ransac_iterations": ({}, 0),
    "evaluation.ground_max_tilt_deg": ({}, 1.0),
    "evaluation.ground_max_offset_m": ({}, 1e-6),
}
PLANNED_BY = ("target.size_error_percent", "target.ground_m")  # in geometric missions


@pytest.mark.slow
@pytest.mark.parametrize(
    "path", [p for p in parameters() if p.split(".")[0] in OF_THE_WORLD and p not in PLANNED_BY]
)
def test_a_rendered_photograph_or_its_measures_notice_it_or_it_is_refused(path):
    seen = measured if path.startswith("evaluation.") else photographed
    check(PhotogrammetricFidelity, seen, path, *scenario(path, SMALL, BESIDE | BESIDE_SCENE))


def test_fewer_pixels_see_less():
    """The calibrated camera is as before; what is seen falls with the focal length and the angle of view."""
    f = MissionConfig().camera.focal_px
    scores = []
    for camera in ((640, 480, f), (1280, 960, 2 * f), (640, 480, 200.0), (64, 48, 46.57)):
        values = dict(zip(("camera.width_px", "camera.height_px", "camera.focal_px"), camera))
        tree = json.loads(mission(json.dumps({"rock": "slab-3", **FEW, **values})))
        scores.append(tree["metrics"]["observable"]["f_score_48mm"] if tree["metrics"] else 0.0)
    same, finer, coarser, tiny = scores
    assert finer > same > coarser > tiny == 0.0
