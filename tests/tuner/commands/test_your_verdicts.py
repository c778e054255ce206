"""Missions of one's own from the campaign to the verdicts: what terminal, JSON and page say of known numbers."""

import html
import json
import re
from pathlib import Path

import pytest
import yaml
from in_process import InProcessExecutor

from tuner.campaign.begin import begin_campaign
from tuner.campaign.campaign import Campaign
from tuner.campaign.session import run_campaign
from tuner.campaign.settings_file import settings_from_dict
from tuner.report.campaign_page import write_campaign_report

FILE = {
    "name": "own",
    "function": "own_mission:run",
    "parameters": {"mode": {"kind": "categorical", "choices": ["slow", "quick"], "default": "slow"}},
    "instances": ["a", "b"],
    "metric": "loss",
    "direction": "minimise",
    "time_limit_s": 60,
}


def evaluated(tmp_path, costs="{}", held_out=("c",), **asked) -> Path:
    """The directory of a finished campaign over a mission file, in which quick has a loss of 7 and slow one of 20."""
    loss = "20.0 if request['configuration']['mode'] == 'slow' else 7.0"
    code = f"def run(request):\n    return {{'metrics': {{'loss': {loss}}}, 'costs': {costs}}}\n"
    (tmp_path / "own_mission.py").write_text(code)
    (tmp_path / "own.yaml").write_text(yaml.safe_dump({**FILE, "held_out": [*held_out]}))
    settings = {"name": "own", "mission": str(tmp_path / "own.yaml"), "budget": 6, "sampler": "random"}
    campaign = begin_campaign(tmp_path / "runs/own", settings_from_dict({**settings, **asked}, "test"))
    assert run_campaign(campaign, InProcessExecutor()).status.finished == 6
    return campaign.directory


def said(gatetune, directory: Path, *command) -> tuple[str, dict, str]:
    """What a comparison of the campaign says on the terminal, as JSON, and on its page."""
    asked = (*command, "--replicates", 1, "--workers", 1)
    out, tree = gatetune.ok(*asked), json.loads(gatetune.ok(*asked, "--json"))
    page = (directory.parents[1] / tree["report"]).read_text() if "report" in tree else ""
    return out, tree, page


def next_command(directory: Path) -> list[str]:
    """What the campaign's page says to run next."""
    found = re.search(r'<pre id="next-command">gatetune (.*?)</pre>', page_of(directory))
    return html.unescape(found[1]).split()


def words_of(page: str) -> str:
    """Without scripts, styles, tags and downloads."""
    return re.sub(r"(?s)<script.*?</script>|<style.*?</style>|<pre.*?</pre>|<[^>]*>", "", page)


def page_of(directory: Path) -> str:
    return write_campaign_report(Campaign.open(directory, read_only=True)).read_text()


@pytest.mark.parametrize("command", ["evaluate", "confirm"])
def test_less_of_what_is_minimised_is_better(gatetune, tmp_path, command):
    directory = evaluated(tmp_path)
    best = Campaign.open(directory, read_only=True).recommendation(save=False)
    assert best.values == {"mode": "quick"} and best.improvement > 5
    out, tree, page = said(gatetune, directory, command, "runs/own", "--mission", "own.yaml")
    line = tree["verdicts"][0]
    assert "a gain of 13.0" in line["text"] and line["kind"] == "no interval"
    assert line["text"] in out and line["text"] in page
    assert tree["summary"]["rows"][0]["differences"]["tuned"]["mean"] == -13.0
    assert "rock" not in out and "photograph" not in out
    assert "dense cloud" not in page and "instance" in page
    assert "rock" not in words_of(page) and "rock" not in words_of(page_of(directory))


def test_a_limit_that_nothing_keeps_is_said(gatetune, tmp_path):
    asked = {"sampler": "gp", "initial": 6, "objective": "costs.fuel@loss<=1"}
    directory = evaluated(tmp_path, "{'fuel': 5.0}", **asked)
    gatetune.ok(*next_command(directory), "--workers", 1)
    out, tree, page = said(gatetune, directory, "evaluate", "runs/own", "--mission", "own.yaml")
    note, limit = tree["notes"][-1], next(v for v in tree["verdicts"] if "Constraint" in v["text"])
    assert limit["kind"] == "not kept"
    assert all(line in out and line in page for line in (note, "0 of 1 instance"))


def test_without_held_out_instances_it_is_confirmed(gatetune, tmp_path):
    directory = evaluated(tmp_path, held_out=())
    words = next_command(directory)
    assert words[0] == "confirm"
    assert said(gatetune, directory, *words)[1]["summary"]["rows"][0]["differences"]["tuned"]["mean"] == -13
