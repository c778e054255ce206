"""The noise study: analysis of variance, exact on hand-made designs, unbiased and calibrated on random ones."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from fake_study import SD
from in_process import InProcessExecutor

from nbv.types import Floats
from tuner.evaluation.plan import EvaluationPlan
from tuner.evaluation.run import run_evaluation
from tuner.problem.space_files import load_search_space
from tuner.studies.noise import analyse, noise_of, noise_plan, write_noise

METRIC = "observable.f_score_48mm"
GATE = load_search_space("gate")


def effects_design(
    rng: np.random.Generator, c: int = 12, k: int = 5, r: int = 3, sd_b: float = 0.8
) -> Floats:
    """(C, K, R) draws of the model."""
    drawn: Floats = (
        50.0
        + 2.0 * rng.normal(size=(c, 1, 1))
        + 1.0 * rng.normal(size=(c, k, 1))
        + 4.0 * rng.normal(size=(1, k, 1))
        + sd_b * rng.normal(size=(1, k, r))
        + 1.5 * rng.normal(size=(c, k, r))
    )
    return drawn


def plan_of(rocks: tuple[str, ...], configurations: int = 24, replicates: int = 3) -> EvaluationPlan:
    return noise_plan(GATE, rocks, configurations, replicates, fidelity="fake_study:fake_study_mission")


def test_a_design_without_noise_is_split_exactly() -> None:
    """Additive in configuration and rock: the configurations' sample variance comes back, everything else is 0."""
    c, k = np.array([1.0, 4.0, 7.0]), np.array([10.0, 30.0])
    found = noise_of(np.broadcast_to(c[:, None, None] + k[None, :, None], (3, 2, 4)).copy())
    assert found.between == pytest.approx(9.0)
    assert found.mission == pytest.approx(0.0, abs=1e-12) and found.signal_to_noise == np.inf


def test_components_are_unbiased() -> None:
    rng = np.random.default_rng(1)
    runs = [noise_of(effects_design(rng)) for _ in range(600)]
    for name, expected in {"between": 4.0 + 1.0 / 5, "mission": 2.25 + 0.64, "paired": 2.25}.items():
        draws = np.array([getattr(run, name) for run in runs])
        assert abs(draws.mean() - expected) < 4 * draws.std() / np.sqrt(len(draws)), name


@pytest.mark.parametrize(("sd_b", "tolerance"), [(0.0, 0.02), (1.0, 0.04)])
def test_the_interval_covers_as_often_as_it_says(sd_b: float, tolerance: float) -> None:
    """Variance between configurations on these rocks is a random draw; its expectation is the model's."""
    rng, true, hits = np.random.default_rng(2), (4.0 + 1.0 / 5) / ((2.25 + sd_b**2) / 5), 0
    for _ in range(1500):
        low, high = noise_of(effects_design(rng, sd_b=sd_b)).interval_95
        hits += low <= true <= high
    assert abs(hits / 1500 - 0.95) < tolerance


@pytest.mark.slow
def test_a_flown_study_finds_the_known_components_and_is_not_flown_twice(tmp_path: Path) -> None:
    """One design of 24 x 4 x 3: within what its degrees of freedom allow."""
    plan = plan_of(("r0", "r1", "r2", "r3"))
    run = run_evaluation(plan, tmp_path / "s", InProcessExecutor())
    assert plan.missions == 4 * 3 * 25 == len(run.records)
    found = analyse(plan, run.records, METRIC)
    assert found is not None and (found.configurations, found.rocks, found.replicates) == (24, 4, 3)
    assert found.paired == pytest.approx(SD["residual"] ** 2, rel=0.3)
    assert found.mission == pytest.approx(SD["residual"] ** 2 + SD["replicate"] ** 2, rel=0.8)
    expected = SD["configuration"] ** 2 + SD["configuration x rock"] ** 2 / 4
    assert found.between == pytest.approx(expected, rel=0.6)
    mirrored = analyse(plan, run.records, "whole.c2c_mean_mm")
    assert mirrored is not None and mirrored.signal_to_noise == pytest.approx(found.signal_to_noise)
    run_evaluation(plan, tmp_path / "s", InProcessExecutor())
    assert all(path.read_text() == "run\n" for path in (tmp_path / "s").rglob("run.txt"))
    report = write_noise([found, mirrored], tmp_path)
    assert json.loads(report.read_text())[0]["between"] == found.between


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["--replicates", "1"], "at least 2"),
        (["--configurations", "1"], "at least 3"),
        (["--rock", "arch"], "held out"),
    ],
)
def test_mistakes_are_one_line_and_write_nothing(gatetune, tmp_path: Path, arguments, says: str) -> None:
    code, _, err = gatetune("study", "noise", "--rock", "boulder", "--space", "gate", *arguments)
    assert code == 2 and says in err and len(err.strip().splitlines()) == 1
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_the_command_flies_and_says_what_was_found(gatetune, tmp_path: Path) -> None:
    asked = ["--configurations", "3", "--replicates", "2", "--fidelity", "geometric", "--metric", METRIC]
    code, out, err = gatetune(
        "study", "noise", "--rock", "slab", "--space", "gate", "--workers", "1", "--out", "s", *asked
    )
    assert code == 0, err
    assert "8 missions, 1 workers" in out and (tmp_path / "s" / "noise.json").is_file()
