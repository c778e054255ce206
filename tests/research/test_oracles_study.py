"""The study of oracle coverages on fake missions with known rewards."""

from __future__ import annotations

import json

import pytest
from in_process import InProcessExecutor

from nbv.errors import UserError
from research.oracles.report import oracles_markdown, write_oracles_report
from research.oracles.study import OracleSettings, analyse
from research.study_directory import run_jobs

ROCKS = ("r0", "r1", "r2")


def settings(**changes):
    defaults = {"rocks": ROCKS, "preset": "paper", "fidelity": "fake_flight:fake_mission"}
    return OracleSettings(**{**defaults, **changes})


@pytest.fixture(scope="module")
def evaluated(tmp_path_factory):
    directory = tmp_path_factory.mktemp("oracles") / "study"
    assert run_jobs(settings(), directory, InProcessExecutor())
    return directory


@pytest.fixture(scope="module")
def findings(evaluated):
    return analyse(evaluated)


def test_every_coverage_is_flown(findings):
    assert findings.missions == findings.expected == (3 + 4 + 3) * 3 * 2
    assert {s.coverage for s in findings.strategies if s.strategy.startswith("hyb-o")} == {
        "reconstruction",
        "seen",
        "matchable",
        "paper-code",
    }


def test_preferences_are_counted(findings):
    r = findings.strategy("hyb-o-reconstruction")
    assert r.prefers_b_aware.mean == 50 and r.prefers_covis.mean == 25 and r.ties.mean == 25
    assert r.flew_b_aware.mean == 50  # ties go to Covis
    assert (r.same_candidate, r.saturated, r.other_ties) == (6, 0, 0)
    assert r.missions_preferring_b_aware == r.missions_preferring_covis == 6 and r.switches
    assert r.missions_saturated == 0 and r.saturates_at is None


def test_saturation_is_the_first_capture_with_nothing_to_gain(findings):
    seen = findings.strategy("hyb-o-seen")
    assert seen.saturates_at == 1 and seen.missions_saturated == 6
    assert (seen.same_candidate, seen.saturated, seen.other_ties) == (0, 12, 0)
    code = findings.strategy("hyb-o-paper-code")
    assert code.saturates_at == 0 and code.missions_saturated == 6 and code.saturated == 24
    assert code.missions_preferring_b_aware == 0 and code.ties.mean == 100 and not code.switches
    matchable = findings.strategy("hyb-o-matchable")
    assert matchable.missions_preferring_b_aware == 0 and not matchable.switches


def test_gains_are_paired_with_every_deployable_strategy(findings):
    r = findings.strategy("hyb-o-seen")
    assert set(r.differences) == {"covis", "b-aware", "hyb-h"}
    d = r.differences["covis"]["observable.f_score_48mm"]
    assert d.pairs == 6 and d.exactly_zero  # the fake's gate does not change the outcome
    assert set(findings.strategy("covis").differences) == {"b-aware", "hyb-h"}
    assert findings.strategy("covis").prefers_b_aware.mean == 50  # judged by the base's coverage


def test_greedy_oracles_say_how_much_is_covered(findings):
    g = findings.strategy("greedy-seen")
    assert (g.covered_first, g.covered_last) == (pytest.approx(10.0), pytest.approx(40.0))
    assert findings.strategy("hyb-o-seen").covered_first is None


def test_the_report_holds_what_was_found(evaluated, findings):
    write_oracles_report(findings, evaluated)
    text = (evaluated / "oracles.md").read_text()
    assert text == oracles_markdown(findings)
    row = next(line for line in text.splitlines() if line.startswith("| Hyb-O, paper-code | paper-code"))
    assert [cell.strip() for cell in row.split("|")[3:9]] == [
        "0",
        "0",
        "100",
        "0, 24, 0",
        "0 of 6",
        "6 of 6 (1)",
    ]
    assert "Paired differences against Hyb-H" in text
    tree = json.loads((evaluated / "oracles.json").read_text())
    names = {s["strategy"]: s["switches"] for s in tree["strategies"]}
    assert names["hyb-o-reconstruction"] and not names["hyb-o-paper-code"]


@pytest.mark.parametrize(
    "changes, says",
    [
        ({"coverages": ("felt",)}, "felt"),
        ({"coverages": ()}, "no coverage"),
        ({"greedy": ("felt",)}, "felt"),
        ({"references": ("greedy-oracle",)}, "ground truth"),
        ({"references": ("clairvoyant",)}, "clairvoyant"),
        ({"surface": "underside"}, "underside"),
        ({"overrides": {"gate.oracle_coverage": "seen"}}, "cannot be set"),
    ],
)
def test_mistakes(changes, says):
    with pytest.raises(UserError, match=says):
        settings(**changes)


@pytest.mark.parametrize(
    "arguments, says",
    [
        (["--coverage", "felt"], "felt"),
        (["--greedy", "felt"], "felt"),
        (["--rock", "arch"], "held out"),
        (["--workers", "0"], "workers"),
        (["--report-only"], "no study of oracles"),
    ],
)
def test_command_line_mistakes_are_one_line_and_write_nothing(study, tmp_path, arguments, says):
    code, _, err = study("oracles", "--rock", "boulder", *arguments)
    assert code == 2 and says in err and len(err.strip().splitlines()) == 1
    assert list(tmp_path.iterdir()) == []


def test_the_command_reports_a_flown_study(study, tmp_path):
    run_jobs(settings(coverages=("seen",), greedy=()), tmp_path / "study", InProcessExecutor())
    code, out, _ = study("oracles", "--report-only", "--out", "study")
    assert code == 0 and "24 of 24 missions" in out and "Hyb-O, seen" in out
    assert (tmp_path / "study" / "oracles.md").is_file()
