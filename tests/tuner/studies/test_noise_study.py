"""The noise study on fake missions with known variance components."""

from __future__ import annotations

import json

import pytest
from fake_study import SD

from nbv.errors import UserError
from nbv.photogrammetric.agreement_levels import AGREEMENT_LEVELS
from tuner.missions.executors import InProcessExecutor
from tuner.problem.space_files import load_search_space
from tuner.studies.noise.report import noise_markdown, write_noise_report
from tuner.studies.noise.study import NoiseSettings, analyse
from tuner.studies.study_directory import fly

METRIC = "observable.f_score_48mm"
ROCKS = ("r0", "r1", "r2", "r3")


def settings(**changes):
    defaults = {
        "space": load_search_space("gate"),
        "rocks": ROCKS,
        "budgets": (8, 16),
        "configurations": 24,
        "replicates": 3,
        "repeats": 2,
        "metrics": (METRIC, "whole.c2c_mean_mm"),
        "fidelity": "fake_study:fake_study_mission",
    }
    return NoiseSettings(**{**defaults, **changes})


@pytest.fixture(scope="module")
def flown(tmp_path_factory):
    directory = tmp_path_factory.mktemp("noise") / "study"
    assert fly(settings(), directory, InProcessExecutor())
    return directory


@pytest.mark.slow
def test_every_mission_is_flown_once(flown):
    runs = list(flown.glob("*/missions/*/*/flown.txt"))
    assert len(runs) == settings().missions == 2 * 4 * (3 * (24 + 4) + 2)
    assert all(path.read_text() == "flown\n" for path in runs)
    assert fly(settings(), flown, InProcessExecutor())  # nothing left to do
    assert all(path.read_text() == "flown\n" for path in runs)


@pytest.mark.slow
def test_the_known_components_are_found(flown):
    """One design of 24 x 4 x 3: within what its degrees of freedom allow."""
    c = analyse(flown).cell(8, 5, METRIC).components
    assert (c.configurations, c.rocks, c.replicates) == (24, 4, 3)
    assert c.residual == pytest.approx(SD["residual"] ** 2, rel=0.3)
    assert c.within == pytest.approx(SD["residual"] ** 2 + SD["replicate"] ** 2, rel=0.8)
    expected = SD["configuration"] ** 2 + SD["configuration x rock"] ** 2 / 4
    assert c.between == pytest.approx(expected, rel=0.6)
    low, high = c.signal_to_noise_interval()
    assert low < c.signal_to_noise < high


@pytest.mark.slow
def test_a_stronger_signal_is_ranked_first(flown):
    findings = analyse(flown)
    ranked = [(c.budget, c.agreement) for c in findings.ranked(METRIC)]
    assert set(ranked[:2]) == {(16, 5), (16, 6)} and ranked[-1] == (8, min(AGREEMENT_LEVELS))
    better, worse = findings.cell(16, 5, METRIC).components, findings.cell(8, 5, METRIC).components
    assert better.between / worse.between == pytest.approx(4.0, rel=0.15)  # twice the effects
    mirrored = findings.cell(16, 5, "whole.c2c_mean_mm").components
    assert mirrored.signal_to_noise == pytest.approx(better.signal_to_noise)


@pytest.mark.slow
def test_repeats_measure_one_configuration(flown):
    cell = analyse(flown).cell(8, 5, METRIC)
    variance, low, high, degrees = cell.default_within
    assert degrees == 4 * (3 + 2 - 1)
    assert low < SD["residual"] ** 2 + SD["replicate"] ** 2 < high and low < variance < high
    assert cell.mission_s == pytest.approx(12 + 8 - 2)  # the extra levels are not charged
    assert {"default", "learned", "random", "greedy-oracle"} < set(cell.means)


@pytest.mark.slow
def test_the_report_holds_what_was_found(flown):
    findings = analyse(flown)
    figures = write_noise_report(findings, flown)
    assert all(path.stat().st_size > 10_000 for path in figures) and len(figures) == 5
    tree = json.loads((flown / "noise.json").read_text())
    cell = next(c for c in tree["cells"] if (c["budget"], c["agreement"], c["metric"]) == (16, 5, METRIC))
    assert cell["signal_to_noise"] == pytest.approx(findings.cell(16, 5, METRIC).components.signal_to_noise)
    assert tree["missions"] == tree["missions_expected"]
    text = (flown / "noise.md").read_text()
    assert text == noise_markdown(findings)
    assert f"{findings.cell(16, 5, METRIC).components.signal_to_noise:.1f}" in text


def test_interrupted_studies_go_on_and_report_what_there_is(tmp_path):
    small = settings(configurations=4, budgets=(8,), repeats=0)

    class Stops(InProcessExecutor):
        left = 4 * 8 * 2 + 3  # two replicates of everything and a little of the third

        def wait_any(self, timeout_s):
            if self.left == 0:
                raise KeyboardInterrupt
            self.left -= 1
            return super().wait_any(timeout_s)

    with pytest.raises(KeyboardInterrupt):
        fly(small, tmp_path / "s", Stops())
    cell = analyse(tmp_path / "s").cell(8, 5, METRIC)
    assert cell.components.replicates == 2 and cell.components.configurations == 4
    assert (
        cell.missing == 4 * 4 - 3 + 1
    )  # the third mission of the third replicate is the second Sobol point's
    assert fly(small, tmp_path / "s", InProcessExecutor())
    assert analyse(tmp_path / "s").cell(8, 5, METRIC).missing == 0


def test_failed_controls_are_counted_not_averaged(tmp_path):
    fly(
        settings(configurations=4, budgets=(8,), repeats=0, rocks=("r0", "failing")),
        tmp_path / "s",
        InProcessExecutor(),
    )
    findings = analyse(tmp_path / "s")
    assert findings.failures == {"seed_model_failed": 3}
    assert "random" not in findings.cell(8, 5, METRIC).means
    assert findings.cell(8, 5, METRIC).components is not None


@pytest.mark.slow
def test_another_study_in_the_directory_is_refused(flown, tmp_path):
    with pytest.raises(UserError, match="another noise study"):
        fly(settings(seed=1), flown, InProcessExecutor())
    (tmp_path / "precious").write_text("mine")
    with pytest.raises(UserError, match="not an empty directory"):
        fly(settings(), tmp_path, InProcessExecutor())
    with pytest.raises(UserError, match="holds no noise study"):
        analyse(tmp_path)


@pytest.mark.parametrize(
    "changes, says",
    [
        ({"replicates": 1}, "at least 2"),
        ({"configurations": 2}, "at least 3"),
        ({"budgets": (8, 8)}, "once"),
        ({"levels": (5, 11)}, "choose from"),
        ({"controls": ("clairvoyant",)}, "clairvoyant"),
        ({"overrides": {"dense.agreeing_views": 3}}, "all its levels"),
        ({"overrides": {"stop.nonsense": 3}}, "stop.nonsense"),
    ],
)
def test_settings_that_make_no_study_are_refused(changes, says):
    with pytest.raises(UserError, match=says):
        settings(**changes)
