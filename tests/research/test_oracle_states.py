"""Every oracle on the planning states of one geometric mission."""

from __future__ import annotations

import json
import shutil

import pytest

from nbv.config import preset
from nbv.errors import UserError
from research.oracles.states import judge, summarise
from research.oracles.study import COVERAGES, judgements, preferences
from research.with_oracle import geometric

BUDGET = 3


@pytest.fixture(scope="module")
def evaluated(tmp_path_factory):
    """A mission that logged its own oracle's rewards, and its directory."""
    directory = tmp_path_factory.mktemp("kept") / "mission"
    values = {
        "stop.adaptive_budget": BUDGET,
        "gate.kind": "covis",
        "gate.oracle_coverage": "matchable",
        "gate.oracle_samples": 2000,
    }
    config = preset("campaign").with_values(values)
    return geometric(config, "boulder", 0, directory), directory


@pytest.fixture(scope="module")
def judged(evaluated):
    return {j.coverage: j for j in judge([evaluated[1]])}


@pytest.mark.slow
def test_the_own_oracle_says_what_the_mission_logged(evaluated, judged):
    result, _ = evaluated
    assert judged["matchable"].preferences == preferences(judgements(result.trace))
    assert judged["matchable"].gate == "covis" and judged["matchable"].rock == "boulder"


@pytest.mark.slow
def test_coverages_differ_as_they_are_defined(judged):
    assert set(judged) == set(COVERAGES)
    code = judged["paper-code"]
    assert code.covered_first == 100 and code.preferences.saturated == BUDGET
    assert code.preferences.saturates_at == 0
    # What enough matchable views see, one view sees; what is seen need not be reconstructed.
    assert 0 < judged["matchable"].covered_first <= judged["seen"].covered_first < 100
    assert judged["reconstruction"].covered_first < judged["seen"].covered_first
    for j in judged.values():
        assert j.covered_last >= j.covered_first and j.preferences.decisions == BUDGET


@pytest.mark.slow
def test_the_summary_adds_up(judged):
    for summary in summarise([*judged.values(), *judged.values()]):
        one = judged[summary.coverage]
        assert summary.missions == 2 and summary.preferences.decisions == 2 * BUDGET
        assert summary.preferences.covis == 2 * one.preferences.covis
        assert summary.covered_first == pytest.approx(one.covered_first)
        assert summary.preferences.saturates_at == one.preferences.saturates_at


@pytest.mark.slow
def test_the_command_writes_the_table(study, evaluated, tmp_path):
    code, out, _ = study("oracle-states", evaluated[1], "--out", "table.md")
    assert code == 0 and "paper-code" in out
    row = next(
        line for line in (tmp_path / "table.md").read_text().splitlines() if line.startswith("| paper-code")
    )
    assert [cell.strip() for cell in row.split("|")[2:7]] == ["1", "3", "0", "0", "100"]


@pytest.mark.slow
def test_mistakes(evaluated, tmp_path):
    with pytest.raises(UserError, match="holds no finished mission"):
        judge([tmp_path])
    shutil.copytree(evaluated[1], tmp_path / "summary")
    shutil.rmtree(tmp_path / "summary" / "states")
    with pytest.raises(UserError, match="planning states"):
        judge([tmp_path / "summary"])
    shutil.copytree(evaluated[1], tmp_path / "other")
    tree = json.loads((tmp_path / "other" / "mission.json").read_text())
    del tree["checksum"]
    text = json.dumps(tree)
    (tmp_path / "other" / "mission.json").write_text(text.replace('"rock": "boulder"', '"rock": "moonstone"'))
    sha = evaluated[0].provenance["rock_sha256"]
    text = (tmp_path / "other" / "mission.json").read_text().replace(sha, "0" * len(sha))
    (tmp_path / "other" / "mission.json").write_text(text)
    with pytest.raises(UserError, match="--rock"):
        judge([tmp_path / "other"])


@pytest.mark.slow
def test_geometric_studies_fly_in_seconds_and_say_what_they_are(study, tmp_path):
    options = ["--set", "stop.adaptive_budget=2", "--set", "gate.oracle_samples=1000", "--replicates", "1"]
    options += ["--fidelity", "geometric", "--rock", "boulder", "--workers", "1"]
    code, out, err = study("oracles", *options, "--coverage", "seen", "--greedy", "none")
    assert code == 0, err
    assert "4 of 4 missions" in out
    text = (tmp_path / "runs" / "oracles" / "oracles.md").read_text()
    assert "no photographs" in text and "| Hyb-O, seen | seen |" in text
    code, _, err = study("oracles", *options[:-4], "--fidelity", "felt", "--rock", "boulder")
    assert code == 2 and "felt" in err
