"""The study of departures on fake missions with known effects."""

from __future__ import annotations

import json

import pytest
from fake_flight import BUDGET
from in_process import InProcessExecutor

from nbv.config import preset
from nbv.errors import UserError
from research.departures.report import departures_markdown, write_departures_report
from research.departures.study import DepartureSettings, analyse
from research.departures.table import DEPARTURES, PAPER_CODE
from research.study_directory import run_jobs

ROCKS = ("r0", "r1", "r2")
F48 = "f_score_48mm"


def settings(**changes):
    defaults = {"rocks": ROCKS, "preset": "paper", "fidelity": "fake_flight:fake_mission"}
    return DepartureSettings(**{**defaults, **changes})


@pytest.fixture(scope="module")
def evaluated(tmp_path_factory):
    directory = tmp_path_factory.mktemp("departures") / "study"
    assert run_jobs(settings(), directory, InProcessExecutor())
    return directory


@pytest.fixture(scope="module")
def findings(evaluated):
    return analyse(evaluated)


def test_together_they_are_the_preset_of_the_public_code():
    ours = preset("paper").with_values(PAPER_CODE).to_dict()
    theirs = preset("paper-code").to_dict()
    assert {**ours, "preset": ""} == {**theirs, "preset": ""}


def test_alone_each_changes_what_the_public_code_changes():
    """Every value of the preset is in some arm of its own."""
    alone = {}
    for d in DEPARTURES.values():
        if not d.name.startswith("paper-code"):
            alone |= {path: value for path, value in d.values.items() if path in PAPER_CODE}
    for path, value in PAPER_CODE.items():
        assert any(d.values.get(path) == value for d in DEPARTURES.values() if "code" not in d.name)
    assert set(alone) == set(PAPER_CODE)


def test_every_distinct_mission_is_flown_once(evaluated):
    s = settings()
    runs = list(evaluated.glob("evaluation/missions/*/*/run.txt"))
    names = {path.parent.parent.name for path in runs}
    assert len(runs) == s.plan().missions == len(names) * len(ROCKS) * 2
    # Read from the base's missions, or from another arm's.
    assert "whole-surface" not in names
    assert {"base-hyb-h", "base-hyb-o", "alphas", "frustum-oracle", "paper-code"} < names
    run_jobs(s, evaluated, InProcessExecutor())
    assert all(path.read_text() == "run\n" for path in runs)


def test_a_known_effect_is_found_on_common_slots(findings):
    """The draw of the slot, which has a standard deviation of 1, cancels."""
    d = findings.arm("alphas").differences[F48]
    assert d.interval.mean == pytest.approx(2.0) and d.pairs == 6 and d.wins == 6
    assert d.interval.high - d.interval.low < 1e-6
    ring = findings.arm("low-ring-rejected").differences[F48].interval
    assert ring.low < -4.0 < ring.high < 0 and ring.excludes_zero
    assert findings.arm("low-ring-rejected").differences["c2c_mean_mm"].losses == 6  # smaller is better


def test_what_changes_nothing_is_exactly_zero_and_shown(findings):
    for name in ("features-16384", "frustum-oracle", "straight-legs"):
        arm = findings.arm(name)
        assert arm.other_views.mean == 0 and arm.same_flights == 6
        assert all(d.interval.mean == 0 and d.pairs == 6 and d.exactly_zero for d in arm.differences.values())
    assert findings.arm("features-16384").changes_nothing
    assert not findings.arm("frustum-oracle").changes_nothing  # it flies Covis throughout: see the share
    assert not findings.arm("alphas").changes_nothing
    row = next(line for line in departures_markdown(findings).splitlines() if "16,384" in line)
    assert row.count("0 exactly") == 8 and "6 of 6" in row


def test_the_gate_and_the_surface_are_measured(findings):
    assert findings.arm("gt-gate").differences[F48].interval.mean == pytest.approx(3.0)
    assert findings.arm("whole-surface").differences[F48].interval.mean == pytest.approx(-5.0)
    assert findings.arm("gt-gate").other_views.mean == 0
    code, ungated = findings.arm("paper-code"), findings.arm("paper-code-ungated")
    gate = code.differences[F48].interval.mean - ungated.differences[F48].interval.mean
    assert gate == pytest.approx(3.0) and code.other_views == ungated.other_views


def test_views_and_choices_are_compared(findings):
    alphas = findings.arm("alphas")
    assert alphas.other_views.mean == pytest.approx(100 * (1 - (BUDGET - 1) / (BUDGET + 1)))
    assert alphas.same_flights == 0
    assert findings.arm("low-ring-rejected").other_views.mean == 100
    base = {b.strategy: b for b in findings.bases}
    assert base["base-hyb-h"].b_aware.mean == 25 and base["base-hyb-o"].b_aware.mean == 50
    frustum = findings.arm("frustum-oracle")
    assert frustum.reference == "base-hyb-o" and frustum.b_aware.interval.mean == -50


def test_what_the_base_does_already_is_named_not_flown():
    s = settings(preset="campaign")
    names = {d.name for d in s.as_base}
    assert names == {"stop-on-budget", "d95-box", "single-image"}
    assert {"d95-all-points", "stop-both", "doubled-image"} < {d.name for d in s.evaluated}
    assert {d.name for d in settings().as_base} == {
        "d95-all-points",
        "exhaustive-matching",
        "stop-both",
        "doubled-image",
    }


def test_the_report_holds_what_was_found(evaluated, findings):
    (figure,) = write_departures_report(findings, evaluated)
    assert figure.stat().st_size > 20_000
    tree = json.loads((evaluated / "departures.json").read_text())
    arm = next(a for a in tree["arms"] if a["departure"]["name"] == "alphas")
    assert arm["differences"][F48]["interval"]["mean"] == pytest.approx(2.0)
    assert tree["missions"] == tree["missions_expected"] == settings().plan().missions
    text = (evaluated / "departures.md").read_text()
    for arm in findings.arms:
        assert f"| {arm.departure.what}" in text
    assert "stop on the KNN distance or the budget" in text.split("Not flown")[1]


def test_failed_missions_leave_their_pairs_out(tmp_path):
    s = settings(rocks=("r0", "failing"), arms=("alphas",))
    run_jobs(s, tmp_path / "s", InProcessExecutor())
    found = analyse(tmp_path / "s")
    assert found.failures == {"seed_model_failed": 2}
    arm = found.arm("alphas")
    assert arm.pairs == 2 and arm.failed == 2 and arm.differences[F48].pairs == 2
    assert "0 of 2, 2 failed" in departures_markdown(found)


def test_reports_of_an_interrupted_study(tmp_path):
    class Stops(InProcessExecutor):
        left = 3

        def wait_any(self, timeout_s):
            if self.left == 0:
                raise KeyboardInterrupt
            self.left -= 1
            return super().wait_any(timeout_s)

    with pytest.raises(KeyboardInterrupt):
        run_jobs(settings(), tmp_path / "s", Stops())
    found = analyse(tmp_path / "s")
    assert found.missions == 3 and found.arm("alphas").pairs == 1
    assert found.arm("d95-box").differences[F48] is None and "–" in departures_markdown(found)
    write_departures_report(found, tmp_path / "s")


def test_another_study_in_the_directory_is_refused(evaluated, tmp_path):
    with pytest.raises(UserError, match="another study of departures"):
        run_jobs(settings(replicates=3), evaluated, InProcessExecutor())
    (tmp_path / "precious").write_text("mine")
    with pytest.raises(UserError, match="not an empty directory"):
        run_jobs(settings(), tmp_path, InProcessExecutor())
    with pytest.raises(UserError, match="no study of departures"):
        analyse(tmp_path)


@pytest.mark.parametrize(
    "changes, says",
    [
        ({"arms": ("alphas", "betas")}, "betas"),
        ({"arms": ("alphas", "alphas")}, "twice"),
        ({"surface": "underside"}, "underside"),
        ({"gate": "clairvoyant"}, "clairvoyant"),
        ({"preset": "thesis"}, "thesis"),
        ({"overrides": {"gate.kind": "covis"}}, "--gate"),
        ({"overrides": {"gate.nonsense": 1}}, "gate.nonsense"),
        ({"rocks": ()}, "no rock"),
    ],
)
def test_mistakes(changes, says):
    with pytest.raises(UserError, match=says):
        settings(**changes)


def test_a_settings_file_with_an_unknown_field_is_named(evaluated, tmp_path):
    text = (evaluated / "departures.yaml").read_text().replace("replicates:", "replicatez:")
    (tmp_path / "departures.yaml").write_text(text)
    with pytest.raises(UserError, match=r"departures.yaml is not a study's settings.*replicatez"):
        DepartureSettings.load(tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize(
    "arguments, says",
    [
        (["--arm", "betas"], "betas"),
        (["--rock", "arch"], "held out"),
        (["--rock", "no-such-rock"], "no-such-rock"),
        (["--workers", "0"], "workers"),
        (["--set", "stop.adaptive_budgit=4"], "stop.adaptive_budget"),
        (["--report-only"], "no study of departures"),
    ],
)
def test_command_line_mistakes_are_one_line_and_write_nothing(study, tmp_path, arguments, says):
    code, _, err = study("departures", "--rock", "boulder", *arguments)
    assert code == 2 and says in err and len(err.strip().splitlines()) == 1
    assert list(tmp_path.iterdir()) == []


def test_the_command_reports_a_flown_study(study, tmp_path):
    run_jobs(settings(arms=("alphas", "features-16384")), tmp_path / "study", InProcessExecutor())
    code, out, _ = study("departures", "--report-only", "--out", "study")
    assert code == 0 and "18 of 18 missions" in out and "+2.00" in out and "0 exactly" in out
    assert (tmp_path / "study" / "departures.md").is_file()
