"""``gatetune study`` from the command line."""

from __future__ import annotations

import json

import pytest

from tuner.missions.executors import InProcessExecutor
from tuner.problem.space_files import load_search_space
from tuner.studies.noise.study import NoiseSettings
from tuner.studies.study_directory import fly

NOISE = ["study", "noise", "--rock", "boulder", "--space", "gate"]


@pytest.mark.parametrize(
    "arguments, says",
    [
        ([*NOISE, "--replicates", "1"], "at least 2"),
        ([*NOISE, "--configurations", "1"], "at least 3"),
        ([*NOISE, "--control", "clairvoyant"], "clairvoyant"),
        ([*NOISE, "--workers", "0"], "workers"),
        ([*NOISE, "--set", "stop.adaptive_budgit=4"], "stop.adaptive_budget"),
        ([*NOISE, "--set", "dense.agreeing_views=4"], "all its levels"),
        (["study", "noise", "--rock", "no-such-rock"], "no-such-rock"),
        (["study", "noise", "--rock", "arch"], "held out"),
        (["study", "noise", "--report-only"], "no noise study"),
        (["study", "sensitivity", "nowhere"], "nowhere"),
        (["mission", "figures", "nowhere", "--rock", "boulder"], "nowhere"),
    ],
)
def test_mistakes_are_one_line_and_write_nothing(gatetune, tmp_path, arguments, says):
    code, _, err = gatetune(*arguments)
    assert code == 2 and says in err and len(err.strip().splitlines()) == 1
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_a_flown_study_is_reported_and_taken_apart(gatetune, tmp_path):
    settings = NoiseSettings(
        load_search_space("gate"),
        ("r0", "r1"),
        (8, 16),
        configurations=8,
        replicates=2,
        repeats=1,
        metrics=("observable.f_score_48mm",),
        fidelity="fake_study:fake_study_mission",
    )
    fly(settings, tmp_path / "study", InProcessExecutor())
    code, out, _ = gatetune("study", "noise", "--report-only", "--out", "study")
    assert code == 0 and "100 of 100 missions" in out and "F-score @ 48 mm" in out
    assert (tmp_path / "study" / "noise.md").is_file()

    # The fake fidelity leaves no config.yaml beside its results; missions flown by nbv do.
    strategies = settings.crossed_plan().strategies
    for path in (tmp_path / "study").rglob("mission.json"):
        config = strategies[path.parent.parent.name]
        (path.parent / "config.yaml").write_text(json.dumps(config.to_dict()))  # JSON is YAML
    metric = ["--metric", "agreement.5.observable.f_score_48mm", "--space", "gate"]
    code, _, err = gatetune("study", "sensitivity", "study", *metric)
    assert code == 2 and "--where stop.adaptive_budget=" in err
    code, out, _ = gatetune("study", "sensitivity", "study", *metric, "--where", "stop.adaptive_budget=8")
    assert code == 0 and "38 missions on 2 rocks" in out
    assert (
        "Left out: 12 missions (differs in what the search space fixes)" in out
    )  # learned, random, greedy oracle
    tree = json.loads((tmp_path / "study" / "sensitivity" / "sensitivity.json").read_text())
    assert {p["path"] for p in tree["parameters"]} == {"gate.budget_fraction", "gate.d95_m"}
