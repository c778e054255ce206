"""The study of transfer: closed forms on known tables, fake missions in two worlds, geometric missions in two worlds."""

from __future__ import annotations

import csv
import dataclasses
import json

import fake_campaigns
import numpy as np
import pytest
from in_process import InProcessExecutor

from nbv.config import load_condition, load_conditions
from nbv.errors import UserError
from research.study_directory import fly
from research.transfer import TransferSettings, World, analyse, worlds
from research.transfer.agreement import agreement, regret, self_agreement, spearman
from research.transfer.report import write_transfer_report
from research.transfer.study import NEIGHBOUR_SD, carried_over
from tuner.problem.search_space import value_at

FAKE = "fake_missions:fake_mission"
TWO = {"plain": World(fidelity=FAKE), "other": World(load_condition("field"), FAKE)}


@pytest.fixture(scope="module")
def campaign(tmp_path_factory):
    return fake_campaigns.run(tmp_path_factory.mktemp("campaign") / "run", sampler="random")


@pytest.fixture(scope="module")
def settings(campaign):
    carried = carried_over(campaign, 6)
    return TransferSettings("test", TWO, carried, ("r0", "r1"), 2, "observable.f_score_48mm")


@pytest.fixture(scope="module")
def flown(settings, tmp_path_factory):
    directory = tmp_path_factory.mktemp("transfer") / "study"
    assert fly(settings, directory, InProcessExecutor())
    return directory


# -- closed forms --------------------------------------------------------------------------------------------


def test_rank_correlation_of_known_tables():
    x = np.array([1.0, 2.0, 3.0, 4.0])
    assert spearman(x, 10 * x**3) == 1 and spearman(x, -x) == -1
    assert spearman(x, np.array([2.0, 1.0, 3.0, 4.0])) == pytest.approx(1 - 6 * 2 / (4 * 15))
    # Ties at their mean rank: 1.5, 1.5, 3, 4 against 1, 2, 3, 4.
    assert spearman(np.array([5.0, 5.0, 6.0, 7.0]), x) == pytest.approx(4.5 / np.sqrt(4.5 * 5))
    assert np.isnan(spearman(np.ones(4), x))


def test_regret_is_what_the_choice_lacks():
    a, b = np.array([3.0, 2.0, 1.0]), np.array([5.0, 9.0, 6.0])
    assert regret(a, b) == 4 and regret(b, a) == 1 and regret(a, a) == 0
    assert regret(np.stack([a, b], 1), np.stack([b, b], 1)).tolist() == [4, 0]


def table(**rows):
    """Outcomes on two rocks with two replicates each."""
    blocks = [("r0", 0), ("r0", 1), ("r1", 0), ("r1", 1)]
    return {name: dict(zip(blocks, values)) for name, values in rows.items()}


def test_worlds_that_only_shift_agree_entirely():
    a = table(x=(1, 2, 3, 4), y=(2, 3, 4, 5), z=(5, 6, 7, 8))
    b = {name: {block: 10 * value - 3 for block, value in own.items()} for name, own in a.items()}
    found = agreement(a, b)
    assert (found.spearman.value, found.spearman.low, found.spearman.high) == (1, 1, 1)
    assert found.chosen == found.best == "z" and found.blocks == 4
    assert (found.regret.value, found.regret.low, found.regret.high) == (0, 0, 0)
    assert self_agreement(a) == 1


def test_an_exception_widens_the_interval():
    a = table(x=(1, 1, 1, 1), y=(2, 2, 2, 2), z=(3, 3, 3, 3))
    b = table(x=(1, 1, 9, 9), y=(2, 2, 2, 2), z=(3, 3, 3, 3))  # on one rock the order is another
    found = agreement(a, b)
    assert found.chosen == "z" and found.best == "x" and found.regret.value == pytest.approx(5 - 3)
    assert found.spearman.value == pytest.approx(-0.5)
    assert found.spearman.low == -0.5 and found.spearman.high == 1
    assert found.regret.low == 0 and found.regret.high == pytest.approx(6)


def test_unfinished_configurations_and_blocks_are_left_out():
    a = table(x=(1, 1, 1, 1), y=(2, 2, 2, 2), z=(3, 3, 3, 3))
    b = table(x=(1, 1, 1, 1), y=(2, 2, 2), z=(3,))
    found = agreement(a, b)
    assert found.configurations == ("x", "y") and found.blocks == 3
    nothing = agreement(a, {name: {} for name in a})
    assert nothing.blocks == 0 and nothing.spearman.value is None and nothing.chosen == ""
    assert self_agreement({"x": {("r0", 0): 1.0}}) is None


# -- missions ------------------------------------------------------------------------------------------------


def test_what_is_carried_over(campaign, settings):
    names = list(settings.configurations)
    assert names[:7] == ["tuned", *(f"neighbour-{i}" for i in range(1, 7))]
    assert {"hyb-h", "covis", "random", "greedy-oracle"} < set(names)
    assert set(names) - set(settings.ranked) == {"hyb-o", "greedy-oracle"} and len(settings.ranked) >= 12
    space = campaign.settings.space

    def position(name):
        config = settings.configurations[name]
        return space.to_unit({path: value_at(config, path) for path in space.paths})

    apart = np.array([position(f"neighbour-{i}") - position("tuned") for i in range(1, 7)])
    assert len({config.digest() for config in settings.configurations.values()}) >= 14
    assert 0 < np.abs(apart).max() < 5 * NEIGHBOUR_SD
    assert carried_over(campaign, 6) == settings.configurations != carried_over(campaign, 6, seed=1)


def test_a_minimised_metric_chooses_the_smallest(settings, tmp_path):
    upside_down = dataclasses.replace(settings, direction="minimise", rocks=("r0",), replicates=1)
    fly(upside_down, tmp_path / "s", InProcessExecutor())
    found = analyse(tmp_path / "s")
    means = {c.name: c.mean.mean for c in found.worlds[1].configurations if c.name in settings.ranked}
    assert means[found.worlds[1].best] == min(means.values())
    pair = found.pairs["plain", "other"]
    assert pair.best == found.worlds[1].best
    assert pair.regret.value == pytest.approx(means[pair.chosen] - min(means.values()))


def test_every_world_is_flown_once_and_goes_on(flown, settings):
    found = analyse(flown)
    distinct = len({config.digest() for config in settings.configurations.values()})
    assert found.missions == found.expected == settings.missions == 2 * distinct * 2 * 2
    assert fly(settings, flown, InProcessExecutor())
    assert all(path.read_text() == "run\n" for path in flown.rglob("run.txt"))
    tuned = found.worlds[0].configuration("tuned")
    hyb_h = found.worlds[0].configuration("hyb-h")
    assert tuned.difference.interval.mean == pytest.approx(tuned.mean.mean - hyb_h.mean.mean)
    assert hyb_h.difference is None and tuned.missions == 4


def test_the_report_holds_what_was_found(flown):
    found = analyse(flown)
    page = write_transfer_report(found, flown, "python -m research.transfer run").read_text()
    assert (
        "Tuned" in page
        and "python -m research.transfer run" in page
        and page.count(".png)") == 2
        and (flown / "gains.png").is_file()
    )
    tree = json.loads((flown / "transfer.json").read_text())
    assert [(p["chosen_in"], p["flown_in"]) for p in tree["pairs"]] == [
        ("plain", "other"),
        ("other", "plain"),
    ]
    assert tree["pairs"][0]["spearman"]["value"] == found.pairs["plain", "other"].spearman.value
    with (flown / "transfer.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 2 * len(found.settings.configurations)
    tuned = next(r for r in rows if (r["world"], r["configuration"]) == ("other", "tuned"))
    assert float(tuned["mean"]) == found.worlds[1].configuration("tuned").mean.mean


def test_failed_missions_are_said(settings, tmp_path):
    some = dataclasses.replace(settings, rocks=("r0", "fail"), replicates=1, worlds={"plain": TWO["plain"]})
    fly(some, tmp_path / "s", InProcessExecutor())
    found = analyse(tmp_path / "s")
    assert set(found.failures) == {"seed_model_failed"} and found.pairs == {}
    page = write_transfer_report(found, tmp_path / "s").read_text()
    assert "seed_model_failed" in page and found.worlds[0].best


@pytest.mark.slow
def test_geometric_missions_in_two_worlds(campaign, tmp_path):
    carried = {n: c for n, c in carried_over(campaign, 0).items() if n in ("tuned", "hyb-h", "random")}
    short = {n: c.with_values({"stop.adaptive_budget": 1}) for n, c in carried.items()}
    two = {
        "ideal": World(fidelity="geometric"),
        "field": World(load_condition("field"), fidelity="geometric"),
    }
    asked = TransferSettings("test", two, short, ("boulder",), 1, "observable.f_score_48mm")
    assert fly(asked, tmp_path / "s", InProcessExecutor())
    found = analyse(tmp_path / "s")
    assert found.missions == found.expected and found.failures == {}
    pair = found.pairs["ideal", "field"]
    assert pair.blocks == 1 and pair.regret.value >= 0 and pair.regret.low is None
    assert all(c.mean.mean > 0 for w in found.worlds for c in w.configurations)
    assert write_transfer_report(found, tmp_path / "s").stat().st_size > 500


def test_worlds_are_combined():
    conditions = load_conditions(["ideal", "low-sun"])
    kinds = ("photogrammetric", "geometric")
    found = worlds(conditions, kinds)
    assert list(found) == [f"{c}-{kind}" for c in ("ideal", "low-sun") for kind in kinds]
    world = found["low-sun-geometric"]
    assert world.condition.name == "low-sun" and world.fidelity == "geometric"


@pytest.mark.parametrize(
    "arguments, says",
    [
        (["--condition", "mars"], "mars"),
        (["--condition", "ideal", "--condition", "ideal"], "twice"),
        (["--fidelity", "cardboard"], "cardboard"),
        (["--neighbours", "-1"], "neighbours"),
        (["--metric", "beauty"], "beauty"),
        (["--rock", "no-such-rock"], "no-such-rock"),
        (["--rock", "arch", "--workers", "0"], "workers"),
        (["--rock", "arch", "--replicates", "0"], "replicates"),
        (["--report-only"], "no study of transfer"),
    ],
)
def test_mistakes_are_one_line_and_write_nothing(study, campaign, tmp_path, arguments, says, monkeypatch):
    monkeypatch.setattr("tuner.campaign.rock_choice.rock_arguments", rocks_as_named)
    code, _, err = study("transfer", campaign.directory, "--out", "study", *arguments)
    assert code == 2 and says in err and len(err.strip().splitlines()) == 1
    assert list(tmp_path.iterdir()) == []


def rocks_as_named(rocks, making=None):
    """The fake campaign's rocks are in no catalogue."""
    if "no-such-rock" in rocks:
        raise UserError("unknown rock 'no-such-rock'")
    return rocks


def test_the_command_reports_a_flown_study(study, flown):
    code, out, _ = study("transfer", "nowhere", "--report-only", "--out", flown)
    assert code == 0 and "Between worlds" in out and "missions; report:" in out
    assert (flown / "report.md").is_file()
