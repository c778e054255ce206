"""Pages and tables of campaigns and comparisons."""

import dataclasses
import functools
import html
import json
import re
import shlex
from pathlib import Path

import fake_campaigns
import pytest
from made_evaluations import made_facts, made_run
from refusals import refused

from tuner.answer.answer import answer_of
from tuner.campaign.begin import begin_campaign
from tuner.campaign.campaign import Campaign
from tuner.campaign.settings import CampaignSettings
from tuner.cli import app
from tuner.comparison.statistics import comparison_table
from tuner.problem.goal import Objective
from tuner.problem.space_files import load_search_space
from tuner.report import words, write_campaign_report
from tuner.report.campaign_page import reproduce_command
from tuner.report.comparison import (
    table_i,
    write_comparison_report,
)
from tuner.report.pages import recorded, recorded_rows

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
    # The plan, the outcomes, a contour of the thresholds, the best posterior mean, and a slice for each parameter.
    assert len(figures) == 4 + campaign.settings.space.dimension
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
def test_the_command_runs_the_same_campaign(tmp_path, monkeypatch, changes):
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


def test_a_campaign_that_is_there_is_not_run_with_other_settings(tmp_path, monkeypatch):
    begin_campaign(tmp_path / "runs/b", fake_campaigns.settings(space=load_search_space("gate"), budget=6))
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("tuner.commands.campaign.run_and_report", lambda *_, **__: None)
    words = ["campaign", "run", "--name", "b", "--resume-if-present", "--budget"]
    app([*words, "6", "--quick"], standalone_mode=False)  # what --quick alone would set is not given
    refused("budget is 6 there, not 12", app, [*words, "12"], standalone_mode=False)


def test_words_where_there_is_one_answer_and_no_interval() -> None:
    assert words.name_in_text("tuned") == "the tuned configuration"
    assert "too few missions" in words.legend([])


def test_campaign_of_failures_alone_has_a_page(tmp_path: Path) -> None:
    page = write_campaign_report(evaluated(tmp_path / "run", rocks=("fail",), budget=20))
    text = text_of(page)
    assert "none of the 8 finished missions succeeded" in text
    assert "Stopped after 8 failures in a row" in text and "seed_model_failed" in text
    assert 'id="tuned-1"' not in page.read_text()


PAPER_ROWS = [f"{name} ↓ (mm)" for name in ("Hausdorff", "Mean C2C", "Median C2C", "P95 C2C")]
PAPER_ROWS += ["Completeness ↑ (%)", "F-score ↑ (%)"] * 2
LEVELS = {"covis": 60.0, "b-aware": 55.0, "hyb-h": 58.0, "hyb-o": 66.0}


def test_table_one_has_its_layout() -> None:
    table = comparison_table(made_run(LEVELS).records, tuple(LEVELS), "hyb-h")
    lines = [line for line in table_i(table, "", paper=True).rows if line.cells]
    metrics = [line for line in lines if line.name in PAPER_ROWS]
    assert [line.name for line in metrics] == PAPER_ROWS
    for line in metrics:
        assert [c.best for c in line.cells] == [False, False, False, True]  # hyb-o leads in all
        assert all(re.fullmatch(r"\[.+, .+\]", c.below[0]) for c in line.cells)
    f_score = table.rows[5].cells["covis"]
    covis, _, reference, _ = metrics[5].cells
    assert covis.text == f"{f_score.mean:.1f}"
    assert covis.below[:2] == (f"[{f_score.low:.1f}, {f_score.high:.1f}]", "paper 72.0")
    assert covis.below[2].startswith("+") and reference.below[1:] == ("paper 67.0",)
    assert [c.text for c in lines[-1].cells] == ["12"] * 4


def test_the_page_names_failures(tmp_path: Path) -> None:
    failed = tuple(("b-aware", "slab", k) for k in range(3))
    facts = made_facts(dataclasses.replace(made_run(LEVELS, failed=failed), directory=tmp_path))
    page = write_comparison_report(facts)
    source = page.read_text()
    text = re.sub(r"\s+", " ", html.unescape(re.sub(r"<[^>]+>", " ", source)))
    assert source.count('id="verdict"') == 1 and "12 paired missions on 4 targets" in text
    assert text.index("Covis is better") < text.index("Table I on the whole")
    assert "B-aware: 3 failed missions" in text and "seed_model_failed 3" in text and "9 + 3 failed" in text
    assert "paper 480.9" in text and "condition ideal" in text
    assert not re.search(r"(src|href)=[\"'](?!data:|#)", source)
    slab = next(row for row in re.findall(r"<tr>.*?</tr>", source) if row.startswith("<tr><td>B-aware</td>"))
    assert slab.count("<td>0.0</td>") == 1  # target by target: the one on which it failed
    assert source.count("Hausdorff ↓ (mm)") == 2  # two surfaces


@pytest.mark.parametrize("provenance", ["text", 7, [1], {"versions": "text"}, {"versions": ["numpy"]}])
def test_a_provenance_that_is_no_record_is_left_out(tmp_path, provenance):
    (tmp_path / "mission.json").write_text(json.dumps({"provenance": provenance}))
    assert recorded([tmp_path]) == []
    assert dict(recorded_rows(recorded([tmp_path])))["machine"] == "not recorded"
