import functools
import html
import re
import shlex
from pathlib import Path

import fake_campaigns
import pytest

from nbv.errors import UserError
from tuner.answer.answer import answer_of
from tuner.campaign.begin import begin_campaign
from tuner.campaign.campaign import Campaign
from tuner.campaign.settings import CampaignSettings
from tuner.cli import app
from tuner.problem.goal import Objective
from tuner.problem.space_files import load_search_space
from tuner.report import words, write_campaign_report
from tuner.report.campaign_page import reproduce_command

evaluated = functools.partial(
    fake_campaigns.run, name="tiny", space=load_search_space("gate"), budget=6, sampler="sobol"
)


def text_of(page: Path) -> str:
    """The page without mark-up and embedded figures, white space collapsed."""
    source = re.sub(r"<(style|script)\b.*?</\1>|<[^>]+>", " ", page.read_text(), flags=re.S)
    return re.sub(r"\s+", " ", html.unescape(source))


@pytest.mark.slow
def test_page_says_what_is_recommended_and_is_self_contained(tmp_path: Path) -> None:
    campaign = evaluated(tmp_path / "run", rocks=("a", "b", "fail"), budget=9)
    page = write_campaign_report(campaign)
    assert page == tmp_path / "run" / "report.html"
    source, text = page.read_text(), text_of(page)
    answer = answer_of(campaign)
    for sentence in [*words.sentences(answer), words.chosen_text(answer.chosen_by)]:
        assert sentence.replace("\u00a0", " ") in text.replace("\u00a0", " ")
    first_screen = text[: text.index("What did tuning earn")].lower()
    assert not [word for word in ("surrogate", "calibrated", "eligible", "posterior") if word in first_screen]
    assert html.unescape(reproduce_command(campaign)) in text
    failed = [t for t in campaign.trials() if t.state == "failed"]
    assert failed[0].reason in text and "no seed model" in text and "9 missions:" in text

    figures = re.findall(r'<img [^>]*src="data:image/svg\+xml', source)
    # The plan, the outcomes, a contour of the thresholds, and a slice for each parameter.
    assert len(figures) == 3 + campaign.settings.space.dimension
    assert not re.search(r"src=[\"'](?!data:)", source)  # self-contained
    assert "url(" not in source and "<script src" not in source and "@import" not in source
    addresses = re.findall(r"href=\"(?!data:|#)([^\"]+)\"", source)
    assert all((page.parent / address).is_file() for address in addresses)


@pytest.mark.slow
@pytest.mark.parametrize(
    "changes",
    [
        {"rocks": ("boulder",), "budget": 5, "replicates": 2, "seed": 7, "in_step": 3, "keep": "all"},
        {"sampler": "gp", "second": Objective("costs.flight_time_s", "minimise"), "limit": 300.0},
        {"overrides": {"gate.kind": "hyb-o", "b_aware.target_track_length": 5}},
    ],
)
def test_the_command_runs_the_same_campaign(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, changes: dict[str, object]
) -> None:
    fields = {"name": "tiny", "space": load_search_space("gate"), "rocks": ("boulder", "slab")}
    asked = CampaignSettings(**{**fields, "budget": 6, "seed": 1, "sampler": "sobol", **changes})
    made = begin_campaign(tmp_path / "run", asked)

    def begin(directory: Path, settings: CampaignSettings) -> Campaign:
        raise LookupError(settings)

    monkeypatch.setattr("tuner.commands.campaign.begin_campaign", begin)
    program, *words = shlex.split(reproduce_command(made))
    with pytest.raises(LookupError) as found:
        app(words, standalone_mode=False)
    assert program == "gatetune" and found.value.args[0].to_dict() == made.settings.to_dict()


def test_a_campaign_that_is_there_is_not_run_with_other_settings(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    begin_campaign(tmp_path / "runs/b", fake_campaigns.settings(space=load_search_space("gate"), budget=6))
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("tuner.commands.campaign.run_and_report", lambda *_, **__: None)
    words = ["campaign", "run", "--name", "b", "--resume-if-present", "--budget"]
    app([*words, "6", "--quick"], standalone_mode=False)  # what --quick alone would set is not given
    with pytest.raises(UserError, match="budget is 6 there, not 12"):
        app([*words, "12"], standalone_mode=False)


def test_campaign_of_failures_alone_has_a_page(tmp_path: Path) -> None:
    page = write_campaign_report(evaluated(tmp_path / "run", rocks=("fail",), budget=20))
    text = text_of(page)
    assert "none of the 8 finished missions succeeded" in text
    assert "Stopped after 8 failures in a row" in text and "seed_model_failed" in text
    assert 'id="tuned-1"' not in page.read_text()
