"""A part of each group that an installed distribution brings is what a mission or campaign really uses."""

import sys

import cv2
import every_part
import numpy as np
import pytest
from scene_helpers import SMALL_GROUND

from nbv import plugins
from nbv.cache import Store
from nbv.config import preset
from nbv.geometry.frames import look_at
from nbv.photogrammetric import run_photogrammetric_mission
from nbv.photogrammetric.simulated_camera import SimulatedCamera
from nbv.rocks import load_coarse_rock
from nbv.scene import build_scene, make_renderer
from nbv.types import Viewpoint


@pytest.fixture
def installed(tmp_path, monkeypatch):
    """The file of the parts."""
    file = every_part.install(tmp_path / "site")
    monkeypatch.syspath_prepend(tmp_path / "site")
    monkeypatch.setattr(plugins, "_registered", {})
    monkeypatch.setattr(plugins, "_used", {})
    plugins.installed.cache_clear()
    yield file
    plugins.installed.cache_clear()
    sys.modules.pop("every_part_module", None)


@pytest.mark.slow
def test_a_mission_with_photographs_uses_renderer_dense_backend_metric_and_family(
    installed, tmp_path, monkeypatch
):
    monkeypatch.setattr("nbv.scene.bake.GroundSpec", lambda: SMALL_GROUND)
    config = preset("campaign").with_values(
        {
            "photographs": 16,
            "seeds": 15,
            "seed.layout": "turn",
            "sparse.ground_features": 2000,
            "dense.max_size_px": 320,
            "evaluation.gt_samples": 10_000,
            "dense.agreeing_views": 3,
            "gate.kind": "last",
            "scene.backend": "dim",
            "dense.backend": "nearer",
        }
    )
    mission = run_photogrammetric_mission(config, "egg-3", 0, tmp_path / "run")
    assert mission.status == "ok", mission.message
    used = {key: facts["distribution"] for key, facts in mission.provenance["plugins"].items()}
    brought = [
        f"{group}/{every_part.PLACES[group][0]}" for group in ("gates", "renderers", "dense", "metrics")
    ]
    assert used == dict.fromkeys([*brought, "families/egg"], "every-part")
    assert [capture.scorer for capture in mission.trace] == ["b-aware"]
    image = cv2.imread(str(next((tmp_path / "run/images").glob("*.png"))))
    assert image.max() <= 130, "photographs at half their brightness"
    assert mission.metric("observable.completeness_48mm") < 20, (
        "a cloud that stands off by a twentieth of 4 m"
    )
    assert mission.metric("observable.farthest_mm") >= mission.metric("observable.c2c_p95_mm")


def test_photographs_and_rocks_are_made_again_where_the_source_changes(installed, tmp_path):
    config = preset("campaign").with_values({"scene.backend": "dim"})
    store, made = Store(tmp_path / "store"), []
    pose = look_at((3.5, 0.0, 1.5), config.target_m)

    def photograph():
        rock = load_coarse_rock("egg-3", store)

        def renderer(camera):
            made.append(rock.sha256)
            return make_renderer(build_scene(rock, config.scene, camera, SMALL_GROUND), "dim")

        camera = SimulatedCamera(renderer, rock, 0, config, store)
        return camera.photograph(Viewpoint("a", (3.5, 0.0, 1.5), 0.0, 20.0, "low"), pose)

    first = photograph()
    assert np.array_equal(photograph(), first) and len(made) == 1
    installed.write_text(every_part.PARTS.replace("// 2", "// 4"))
    plugins.installed.cache_clear()
    sys.modules.pop("every_part_module")
    assert photograph().mean() < 0.6 * first.mean() and len(made) == 2
