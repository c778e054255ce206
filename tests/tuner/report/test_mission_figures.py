"""The paper's figures of a real mission, and of a cloud that lies a known distance beside the truth."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import matplotlib.image
import numpy as np
import pytest

from nbv.cache import Store
from nbv.config import preset
from nbv.geometric import run_geometric_mission
from nbv.geometry.sampling import sample_surface
from nbv.mission.planning_state import load_state
from nbv.mission.run_directory import write_ply
from nbv.rocks import load_rock
from nbv.types import PointCloud
from tuner.report.mission_figures import (
    labels_of,
    overlay_figure,
    trajectory_figure,
    write_mission_figures,
)

CAPTURES = 3
OFFSET_M = 0.01


@pytest.fixture(scope="module")
def evaluated(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A mission whose cloud lies `OFFSET_M` outside the rock's upper half, and has nothing of the lower."""
    run = tmp_path_factory.mktemp("run") / "first"
    config = preset("campaign").with_values(
        {"stop.adaptive_budget": CAPTURES, "evaluation.gt_samples": 20_000}
    )
    assert run_geometric_mission(config, "slab", 0, run).status == "ok"
    rock = load_rock("slab", Store())
    points, normals = sample_surface(rock.vertices_m, rock.faces, 20_000, 1)
    upper = points[:, 2] > np.median(points[:, 2])
    write_ply(run / "cleaned.ply", PointCloud(points[upper] + OFFSET_M * normals[upper]))
    return run


@pytest.mark.slow
def test_all_figures_are_written(evaluated: Path, tmp_path: Path) -> None:
    runs = labels_of([evaluated, Path(shutil.copytree(evaluated, tmp_path / "two"))])
    assert list(runs) == ["Hyb-H (first)", "Hyb-H (two)"]
    written = write_mission_figures(runs, tmp_path / "out")
    assert {p.name.partition("_")[0] for p in written} == {"trajectory", "overlay", "sectors.png"}
    assert len(written) == 5
    for path in written:
        pixels = matplotlib.image.imread(path)
        assert pixels.shape[0] > 300 and pixels[..., :3].std() > 0.03  # something is drawn


def test_a_geometric_mission_has_all_figures_but_the_overlay(evaluated: Path, tmp_path: Path) -> None:
    run = Path(shutil.copytree(evaluated, tmp_path / "shown", ignore=shutil.ignore_patterns("cleaned.ply")))
    written = write_mission_figures(labels_of([run]), tmp_path / "out")
    assert [p.name for p in written] == ["trajectory_Hyb-H.png", "sectors.png"]


def test_overlay_measures_against_the_surface_itself(evaluated: Path) -> None:
    title = overlay_figure(evaluated).get_suptitle()
    error_mm = float(title.split("median error of the cloud ")[1].split()[0])
    assert error_mm == pytest.approx(1000 * OFFSET_M, abs=1.0)
    reached = int(title.split(" % of the whole")[0].rsplit(" ", 1)[1])
    assert 50 <= reached <= 65  # the upper half, and 48 mm below it


def test_trajectory_shows_the_views_of_the_trace(evaluated: Path) -> None:
    figure = trajectory_figure(evaluated)
    names = [text.get_text() for text in figure.legends[0].get_texts()]
    assert "24 seed views" in names and any(name.startswith("3 selected views") for name in names)
    (plan,) = figure.axes
    assert [text.get_text() for text in plan.texts] == ["1", "2", "3"]
    _, pool = load_state(evaluated / "states" / "iter_00.npz")
    chosen = json.loads((evaluated / "trace.jsonl").read_text().splitlines()[0])["chosen"]
    assert plan.texts[0].get_position() == pytest.approx(tuple(pool.positions_m[pool.ids.index(chosen)][:2]))
    orbit, adaptive = (np.array(line.get_data()).T for line in plan.lines)
    np.testing.assert_allclose(adaptive[0], orbit[-1])  # from the last seed on
    assert np.isnan(orbit[0]).all()  # home is outside the square
