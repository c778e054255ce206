import dataclasses
import functools
import shutil
from pathlib import Path

import fake_campaigns
import pytest
import synthetic

from nbv.errors import UserError
from tuner.campaign.begin import learn_from
from tuner.campaign.campaign import Campaign
from tuner.cli import app
from tuner.comparison.of_campaign import require_comparable
from tuner.problem.observations import Observation
from tuner.problem.search_space import SearchSpace
from tuner.report.campaign_page import write_campaign_report
from tuner.samplers.earlier_missions import EarlierMissions

FRACTION, D95 = synthetic.SPACE.parameters
ONE_PARAMETER = dataclasses.replace(synthetic.SPACE, name="one", parameters=(FRACTION,))
run = functools.partial(fake_campaigns.run, budget=24)


@pytest.fixture(scope="module")
def earlier(tmp_path_factory: pytest.TempPathFactory) -> Campaign:
    return run(tmp_path_factory.mktemp("earlier") / "run")


def learned(campaign: Campaign, space: SearchSpace) -> list[Observation]:
    s = fake_campaigns.settings(space=space, rocks=("c",))
    return list(learn_from([str(campaign.directory)], s.problem, s.objective).observations)


@pytest.mark.slow
def test_the_best_of_an_earlier_campaign_fly_first_on_new_rocks(earlier: Campaign, tmp_path: Path) -> None:
    known = shutil.copytree(earlier.directory, tmp_path / "known")
    campaign = run(tmp_path / "run", rocks=("c", "d"), budget=8, learn_from=(str(known),))
    trials = campaign.trials()
    assert [t.record.metadata["phase"] for t in trials[:3]] == ["default", "default", "earlier missions"]
    assert campaign.learned is not None and trials[2].values == campaign.learned.best(1)[0]
    # Near the optimum, where the default is not.
    assert synthetic.true_value(trials[2].values) > 0.9 > synthetic.true_value(trials[0].values)
    shutil.rmtree(known)  # the campaign has its own copy
    again = Campaign.open(campaign.directory)
    assert again.learned is not None and again.learned.best(3) == campaign.learned.best(3)
    page = write_campaign_report(again).read_text()
    assert "missions of earlier campaigns" in page and "learn_from:" in page
    (campaign.directory / "learned_from.json").unlink()
    with pytest.raises(UserError, match=r"learned_from.json cannot be read .* restore it"):
        Campaign.open(campaign.directory)


@pytest.mark.slow
def test_missions_are_moved_between_search_spaces(earlier: Campaign, tmp_path: Path) -> None:
    evaluated, known = earlier.history(), learned(earlier, synthetic.SPACE)
    assert [(o.values, o.outcome) for o in known] == [(o.values, o.outcome) for o in evaluated]
    # From one parameter to two: the second has the value at which it was held. What neither tunes may differ.
    fixed = {"dense.agreeing_views": 3}
    small = run(tmp_path / "small", space=ONE_PARAMETER, sampler="sobol", overrides=fixed)
    moved = learned(small, synthetic.SPACE)
    assert len(moved) == len(small.history())
    assert {o.values["gate.d95_m"] for o in moved} == {small.settings.problem.base.gate.d95_m}
    # From two to one: only the missions that have the other at its default, here the first two.
    with pytest.raises(UserError, match="2 of its 24 missions are configurations of search space 'one'"):
        learned(earlier, ONE_PARAMETER)
    low = dataclasses.replace(FRACTION, high=0.4)
    narrow = dataclasses.replace(synthetic.SPACE, name="narrow", parameters=(low, D95))
    inside = sum(o.values["gate.budget_fraction"] <= 0.4 for o in evaluated)
    assert 0 < inside < 20
    with pytest.raises(UserError, match=f"{inside} of its 24 missions"):
        learned(earlier, narrow)


@pytest.mark.slow
def test_what_cannot_be_learned_from_is_named(earlier: Campaign, tmp_path: Path) -> None:
    with pytest.raises(UserError, match="nowhere"):
        run(tmp_path / "run", learn_from=(str(tmp_path / "nowhere"),))
    same = earlier.directory / ".." / earlier.directory.name
    with pytest.raises(UserError, match="is named twice to learn from"):
        run(tmp_path / "run", learn_from=(str(earlier.directory), str(same)))
    assert not (tmp_path / "run").exists()
    with pytest.raises(UserError, match="learning from earlier campaigns needs sampler gp, not sobol"):
        fake_campaigns.settings(sampler="sobol", learn_from=(str(earlier.directory),))


@pytest.mark.slow
def test_evaluation_refuses_rocks_that_were_learned_from(tmp_path: Path) -> None:
    first = run(tmp_path / "first", rocks=("any-cleft",), sampler="sobol")
    second = run(tmp_path / "second", rocks=("boulder",), initial=24, learn_from=(str(first.directory),))
    sources = (str(second.directory),)
    third = run(tmp_path / "third", rocks=("slab",), budget=6, learn_from=sources)
    for rock in ("boulder", first.settings.problem.drawn_rock("any-cleft", 0)):
        with pytest.raises(UserError, match=rf"rock '{rock}' was tuned on in .* learned from"):
            app(["evaluate", str(third.directory), "--rock", rock], standalone_mode=False)
        with pytest.raises(UserError, match=f"{rock} is compared on, and what the campaign learns from"):
            require_comparable(fake_campaigns.settings(compare_on=(rock,), learn_from=sources))
    of_earlier_version = EarlierMissions.from_json('{"rocks": ["boulder"], "missions": []}', synthetic.SPACE)
    assert not of_earlier_version.seen
