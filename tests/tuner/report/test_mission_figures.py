"""Mission figures from a small made mission directory."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import matplotlib.image
import numpy as np
import pytest
import trimesh
from fake_missions import well_flown

from nbv.config import MissionConfig, preset
from nbv.errors import UserError
from nbv.mission.planning_state import save_state
from nbv.mission.result import MissionResult
from nbv.mission.run_directory import RunDirectory
from nbv.rocks.rock import make_rock
from nbv.types import CandidatePool, PlanningState, PointCloud, SparseModel
from tuner.report.mission import walk_world
from tuner.report.mission.figures import labels_of, sectors_figure, write_mission_figures
from tuner.report.mission.overlay import overlay_figure
from tuner.report.mission.trajectory import trajectory_figure
from tuner.report.sectors import mean_sectors

CAPTURES = 3


def made_mission(root: Path, gate: str = "hyb-h", offset_m: float = 0.01) -> Path:
    """A mission around a ball of 0.8 m radius whose cloud lies ``offset_m`` outside it, upper half only."""
    config: MissionConfig = preset("campaign").with_values({"gate.kind": gate})
    run = RunDirectory(root)
    run.write_config(config.to_dict())
    angles = np.linspace(0, 2 * np.pi, 24, endpoint=False)
    seeds = np.stack([4 * np.cos(angles), 4 * np.sin(angles), np.full(24, 2.0)], 1)
    pool_m = np.stack([3.5 * np.cos(angles), 3.5 * np.sin(angles), np.full(24, 1.5)], 1)
    model = SparseModel(
        seeds,
        np.zeros(24),
        2 * np.arange(25),
        np.zeros(48, dtype=np.int64),
        seeds,
        tuple(f"seed_{i:02d}.png" for i in range(24)),
        0.001,
        0.002,
    )
    pool = CandidatePool(
        tuple(f"cand_{i:03d}" for i in range(24)),
        pool_m,
        angles,
        np.rad2deg(angles),
        np.full(24, 10.0),
        ("lateral",) * 24,
    )
    for k in range(CAPTURES):
        visited = np.concatenate([seeds, pool_m[:k]])
        save_state(run.state_path(k), PlanningState(model, visited, 24, seeds[0], 0.0, k, 8, 0.2, k), pool)
        same = {"candidate": f"cand_{k:03d}"}
        run.append_trace(
            {
                "iteration": k,
                "chosen": f"cand_{k:03d}",
                "scorer": "b-aware" if k < 2 else "covis",
                "d95_m": 0.2 - 0.04 * k,
                "n_points": 100 + k,
                "n_registered": 24 + k,
                "registered": k != 1,
                "top": {"covis": same, "b-aware": same if k else {"candidate": "cand_009"}},
            }
        )
    path = np.concatenate([[[0, -8, 0], [0, -8, 3]], seeds, pool_m[:CAPTURES]])
    # One sample a second: take-off, 24 seeds, the selected views, and back.
    path = np.concatenate([path, [[0, -8, 3]]])
    names = {"take-off": 0, "seed_00": 1, "cand_000": 25, "return": 25 + CAPTURES}
    run.write_json(
        "flight.json",
        {
            "samples": [[float(t), *map(float, p), 0.0] for t, p in enumerate(path)],
            "events": [{"name": n, "start_s": float(t), "duration_s": 0.0} for n, t in names.items()],
            "flight_time_s": float(len(path)),
        },
    )
    ball = trimesh.creation.icosphere(subdivisions=4, radius=0.8 + offset_m).vertices
    upper = ball[ball[:, 2] > 0] + [0, 0, 0.8]
    run.write_cloud("cleaned.ply", PointCloud(upper))
    sectors = [90.0 - k for k in range(11)] + [None]
    surface = {"sector_completeness_48mm": sectors}
    metrics = {
        "whole": surface,
        "observable": surface,
        "sector_centers_deg": [15.0 + 30 * k for k in range(12)],
    }
    run.write_result(well_flown(config, "ball", 0, metrics).to_json())
    return root


@pytest.fixture
def rock(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    """A ball known to the figures."""
    ball = trimesh.creation.icosphere(subdivisions=4, radius=0.8)
    vertices = np.asarray(ball.vertices) + np.array([0, 0, 0.8])
    subject = make_rock(
        "ball",
        vertices,
        np.asarray(ball.faces),
        np.full((len(vertices), 3), 0.3, np.float32),
        split="extra",
        difficulty="none",
    )
    monkeypatch.setattr(walk_world, "load_rock", lambda name, store: {"ball": subject}[name])
    return "ball"


@pytest.mark.slow
def test_all_figures_are_written(tmp_path: Path, rock: str) -> None:
    runs = labels_of([made_mission(tmp_path / "one"), made_mission(tmp_path / "two", "hyb-o")])
    assert list(runs) == ["Hyb-H", "Hyb-O"]
    written = write_mission_figures(runs, tmp_path / "out")
    assert {p.name for p in written} == {
        *(f"{kind}_{label}.png" for kind in ("trajectory", "overlay") for label in runs),
        "sectors.png",
    }
    for path in written:
        pixels = matplotlib.image.imread(path)
        assert pixels.shape[0] > 300 and pixels[..., :3].std() > 0.03  # something is drawn


def test_overlay_measures_against_the_surface_itself(tmp_path: Path, rock: str) -> None:
    title = overlay_figure(made_mission(tmp_path / "run", offset_m=0.01)).get_suptitle()
    error_mm = float(title.split("median error of the cloud ")[1].split()[0])
    assert error_mm == pytest.approx(10.0, abs=1.0)
    reached = int(title.split(" % of the whole")[0].rsplit(" ", 1)[1])
    assert 48 <= reached <= 56  # half the ball, and 48 mm below the equator


def test_trajectory_shows_the_views_of_the_trace(tmp_path: Path) -> None:
    figure = trajectory_figure(made_mission(tmp_path / "run"))
    names = [text.get_text() for text in figure.legends[0].get_texts()]
    assert "24 seed views" in names and any(name.startswith("3 selected views") for name in names)
    assert "24 candidates at the first iteration" in names
    plan = figure.axes[1]
    assert [text.get_text() for text in plan.texts] == ["1", "2", "3"]
    assert plan.texts[0].get_position() == pytest.approx((3.5, 0.0))  # where cand_000 is
    orbit, adaptive = (np.array(line.get_data()).T for line in plan.lines)
    assert np.isnan(orbit[0]).all()  # home is outside the square
    np.testing.assert_allclose(adaptive[0], orbit[-1])  # the last seed
    assert len(adaptive) == 1 + CAPTURES and len(orbit) == 2 + 24


def test_sectors_without_samples_are_gaps() -> None:
    mean = mean_sectors([[50.0, None, None], [70.0, 20.0, None]])
    np.testing.assert_array_equal(mean, [60.0, 20.0, np.nan])


def test_what_is_missing_is_named(tmp_path: Path) -> None:
    run = made_mission(tmp_path / "run")
    (run / "flight.json").unlink()
    with pytest.raises(UserError, match=r"no flight\.json"):
        trajectory_figure(run)
    failed = dataclasses.replace(MissionResult.load(run), status="failed", reason="seed_model_failed")
    (run / "mission.json").write_text(failed.to_json())
    with pytest.raises(UserError, match="failed mission"):
        sectors_figure({"x": run})
    (run / "config.yaml").unlink()
    with pytest.raises(UserError, match=r"no config\.yaml"):
        trajectory_figure(run)
