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
    "held_out": ["c"],
    "metric": "loss",
    "direction": "minimise",
    "time_limit_s": 60,
}


def evaluated(tmp_path, returned: str, file=None, **asked) -> Path:
    """The directory of a finished campaign over a mission file whose missions return ``returned`` of the mode ``m``."""
    code = f"def run(request):\n    m = request['configuration']['mode']\n    return {returned}\n"
    (tmp_path / "own_mission.py").write_text(code)
    (tmp_path / "own.yaml").write_text(
        yaml.safe_dump({key: value for key, value in {**FILE, **(file or {})}.items() if value})
    )
    settings = {"name": "own", "mission": str(tmp_path / "own.yaml"), "budget": 6, "sampler": "random"}
    campaign = begin_campaign(tmp_path / "runs/own", settings_from_dict({**settings, **asked}, "test"))
    assert run_campaign(campaign, InProcessExecutor()).status.finished == 6
    return campaign.directory


def said(gatetune, directory: Path, *command) -> tuple[str, dict, str]:
    """What a comparison of the campaign says on the terminal, as JSON, and on its page."""
    code, out, err = gatetune(*command, "--replicates", 1, "--workers", 1)
    assert code == 0, err
    code, document, err = gatetune(*command, "--replicates", 1, "--workers", 1, "--json")
    assert code == 0, err
    tree = json.loads(document)
    page = (directory.parents[1] / tree["report"]).read_text() if "report" in tree else ""
    return out, tree, page


def next_command(directory: Path) -> list[str]:
    """What the campaign's page says to run next."""
    found = re.search(r'<pre id="next-command">gatetune (.*?)</pre>', page_of(directory))
    assert found is not None
    return html.unescape(found[1]).split()


def words_of(page: str) -> str:
    """Without scripts, styles, tags and downloads."""
    return re.sub(r"(?s)<script.*?</script>|<style.*?</style>|<pre.*?</pre>|<[^>]*>", "", page)


def page_of(directory: Path) -> str:
    return write_campaign_report(Campaign.open(directory, read_only=True)).read_text()


@pytest.mark.parametrize("command", ["evaluate", "confirm"])
def test_less_of_what_is_minimised_is_better(gatetune, tmp_path, command):
    """7 in place of 20 is an improvement of 13."""
    directory = evaluated(tmp_path, "{'metrics': {'loss': 20.0 if m == 'slow' else 7.0}}")
    best = Campaign.open(directory, read_only=True).recommendation(save=False)
    assert best.values == {"mode": "quick"} and best.improvement > 5
    out, tree, page = said(gatetune, directory, command, "runs/own", "--mission", "own.yaml")
    line = tree["verdicts"][0]
    assert "a gain of 13.0" in line["text"] and line["kind"] == "no interval"
    assert line["text"] in out and line["text"] in page
    difference = tree["summary"]["rows"][0]["differences"]["tuned"]
    assert difference["mean"] == -13.0
    assert "rock" not in out and "photograph" not in out
    assert "dense cloud" not in page and "instance" in page
    assert "rock" not in words_of(page) and "rock" not in words_of(page_of(directory))


def test_a_limit_that_nothing_keeps_is_said(gatetune, tmp_path):
    returned = "{'metrics': {'loss': 20.0 if m == 'slow' else 7.0}, 'costs': {'fuel': 5.0}}"
    directory = evaluated(tmp_path, returned, sampler="gp", initial=6, objective="costs.fuel@loss<=1")
    code, out, err = gatetune("campaign", "status", "runs/own")
    assert code == 0 and "Loss at most 1" in out, err
    best = Campaign.open(directory, read_only=True).recommendation(save=False)
    assert best.limit is not None and not best.limit.kept
    code, out, err = gatetune(*next_command(directory), "--workers", 1)
    assert code == 0, out + err
    out, tree, page = said(gatetune, directory, "evaluate", "runs/own", "--mission", "own.yaml")
    note, limit = tree["notes"][-1], next(v for v in tree["verdicts"] if "Constraint" in v["text"])
    assert limit["kind"] == "not kept"
    assert all(line in out and line in page for line in (note, "0 of 1 instance"))


def test_without_held_out_instances_it_is_confirmed(gatetune, tmp_path):
    directory = evaluated(tmp_path, "{'metrics': {'loss': 20.0 if m == 'slow' else 7.0}}", {"held_out": []})
    words = next_command(directory)
    assert words[0] == "confirm"
    assert said(gatetune, directory, *words)[1]["summary"]["rows"][0]["differences"]["tuned"]["mean"] == -13
