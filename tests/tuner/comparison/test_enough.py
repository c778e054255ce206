from pathlib import Path

import numpy as np
import pytest
from made_evaluations import made_trial
from photographed_ball import spread, write_set
from scene_helpers import around
from typer.testing import CliRunner

from nbv.errors import UserError
from nbv.photographs import PhotographSet
from nbv.photographs.photograph_fidelity import PhotographViewpoints
from tuner.cli import app
from tuner.comparison.plan import EvaluationPlan, EvaluationRun
from tuner.missions.job import Trial
from tuner.report.enough import ALL, draw_enough, enough_plans, enough_text, read_enough


@pytest.fixture
def ball(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> PhotographSet:
    monkeypatch.setenv("GATETUNE_HOME", str(tmp_path / "home"))
    return write_set("ball", spread(40), rendered=False)


def run(plan: EvaluationPlan, values: dict[str, list[tuple[float, int]]], names: list[str]) -> EvaluationRun:
    """Missions with these qualities and numbers of photographs."""

    def trial(strategy: str, k: int, quality: float, count: int) -> Trial:
        found = {"observable": {"f_score_48mm": quality}, "reference": {"ceiling": {"f_score_48mm": 99.0}}}
        costs = {"images": float(count), "registered_images": count - 1.0}
        measured = {"metrics": {**found, "taken": names[:count]}, "costs": costs}
        return made_trial(strategy, "ball", k, status="ok" if quality else "failed", measured=measured)

    records = [trial(s, k, *found) for s, several in values.items() for k, found in enumerate(several)]
    return EvaluationRun(plan, records, True, 0.0, Path())


def test_the_smallest_set_that_keeps_what_was_asked_for(ball: PhotographSet, tmp_path: Path) -> None:
    names = [p.name for p in ball.registered]
    everything, few = enough_plans(ball, (16, 20, 24), replicates=3).values()
    evaluated = {
        "ring-16": [(70.0, 16), (60.0, 15), (65.0, 16)],
        "ring-20": [(80.0, 20), (70.0, 20), (75.0, 20)],
        "ring-24": [(88.0, 24), (87.8, 23), (88.1, 24)],
        "random-20": [(72.0, 20), (0.0, 20), (36.0, 20)],
        # Two missions of three would have done, the plan would not.
        "tuned-20": [(74.2, 20), (98.2, 20), (98.5, 20)],
    }
    found = read_enough(run(everything, {ALL: [(90.0, 36)]}, names), run(few, evaluated, names), 95.0)
    assert found.asked_quality == pytest.approx(85.5)
    assert (found.smallest.way, found.smallest.replicate) == ("ring", 0)  # the median, not the best
    assert found.smallest.taken == tuple(names[:24])
    random = found.curves["random"][0]
    assert (random.quality.mean, random.registered) == (36.0, 19.0)  # a failed mission counts
    bounds = [(p.quality.low, p.quality.high) for points in found.curves.values() for p in points]
    assert all(0.0 <= low < high <= 100.0 for low, high in bounds) and bounds[-1][1] == 100.0
    with pytest.raises(UserError, match="--replicates must be 2 or more"):
        enough_plans(ball, (16,), replicates=1)
    assert np.isclose(found.ceiling, 99.0)
    picture = draw_enough(found, ball, 95.0, tmp_path / "enough.png")
    assert picture.stat().st_size > 20_000
    nothing = read_enough(run(everything, {ALL: [(99.0, 36)]}, names), run(few, evaluated, names), 100.0)
    assert nothing.smallest is None
    with pytest.raises(UserError, match="all photographs gave no"):
        read_enough(run(everything, {ALL: [(0.0, 36)]}, names), run(few, evaluated, names), 95.0)


def test_a_number_is_not_enough_where_a_larger_one_fails(ball: PhotographSet) -> None:
    names = [p.name for p in ball.registered]
    everything, few = enough_plans(ball, (16, 20, 24), replicates=3).values()
    evaluated = {
        "ring-16": [(89.0, 13), (88.5, 13), (89.2, 13)],
        "ring-20": [(0.0, 0), (0.0, 0), (0.0, 0)],
        "random-20": [(87.0, 20), (87.3, 20), (87.1, 20)],
        "random-24": [(80.0, 24), (90.0, 24), (91.0, 24)],
    }
    found = read_enough(run(everything, {ALL: [(90.0, 36)]}, names), run(few, evaluated, names), 95.0)
    assert found.smallest.way == "random" and len(found.smallest.taken) == 20
    assert (found.curves["ring"][1].failed, found.curves["ring"][1].asked) == (3, 20)
    assert "20 photographs would have been enough: random" in enough_text(found, 95.0, Path("listed"))


def test_a_ring_has_its_number_where_one_side_was_not_photographed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("GATETUNE_HOME", str(tmp_path / "home"))
    part = write_set("part", around(np.linspace(0.0, 230.0, 47), 25.0), rendered=False)
    few = enough_plans(part, (16, 20, 24))["few"]
    for number in (16, 20, 24):
        config = few.strategies[f"ring-{number}"]
        places = PhotographViewpoints(
            [p.camera_center_m for p in part.registered], part.target_m, config, "key", 1
        )
        assert abs(len(places.seeds(config)) - number) <= 1


@pytest.mark.slow
def test_the_command_lists_the_files_that_would_have_done(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("GATETUNE_HOME", str(tmp_path / "home"))
    made = write_set("ball", spread(20), rendered=True)
    asked = ["photographs", "enough", "ball", "--number", "16", "--replicates", "2", "--workers", "1"]
    asked += ["--keep", "60", "--out", str(tmp_path / "out"), "--set", "dense.agreeing_views=3"]
    asked += ["--set", "evaluation.gt_samples=5000"]
    said = CliRunner().invoke(app, asked)
    assert said.exit_code == 0, said.output
    assert "of one processor" in said.output
    listed = (tmp_path / "out" / "enough.txt").read_text().split()
    assert 14 <= len(listed) <= 16 and set(listed) <= {p.source for p in made.photographs}
    assert (tmp_path / "out" / "enough.png").is_file()
    missions = sorted((tmp_path / "out").rglob("mission.json"))
    times = [path.stat().st_mtime_ns for path in missions]
    assert CliRunner().invoke(app, asked).exit_code == 0
    assert [path.stat().st_mtime_ns for path in missions] == times  # nothing is run again
    assert "must be above 0" in str(CliRunner().invoke(app, [*asked, "--keep", "0"]).exception)
