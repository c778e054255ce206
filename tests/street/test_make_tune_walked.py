"""`make tune` and `make tune-photographs` in small, and the whole way on: one recommendation, the same values everywhere."""

import html
import json
import re

import pytest
import yaml
from street import ROOT, SMALL, Street, commands_on

from nbv.config import config_from_dict
from tuner.campaign.campaign import Campaign
from tuner.problem.baselines import label

BUDGET = "16"


def recipe(target: str, name: str) -> str:
    """The command line of a target of the Makefile, for a run of this name."""
    lines = re.sub(r"\\\n\s*", " ", (ROOT / "Makefile").read_text())
    command = re.search(rf"^{target}: setup\n\t\$\(BIN\)/(gatetune.*)$", lines, re.MULTILINE)[1]
    return command.replace("$(RUN)-photographs", name).replace("$(RUN)", name)


@pytest.mark.slow
def test_from_make_tune_to_every_command_that_it_names(tmp_path):
    street = Street(tmp_path, SMALL | {"budget": BUDGET})
    terminal = street.run(recipe("tune", "tune"))
    answer = json.loads(street.run("gatetune campaign status runs/tune --json"))["recommendation"]
    page = street.file("runs/tune/report.html")
    result = json.loads(street.file("runs/tune/comparison.json"))
    recommended = same_everywhere(street, answer)
    plan = yaml.safe_load(street.file("runs/tune/evaluation/evaluation.yaml"))
    assert config_from_dict(plan["strategies"]["tuned"]).digest() == recommended
    for block in result["blocks"]:
        for name in map(label, block["table"]["strategies"]):
            assert name in terminal and name in html.unescape(page)
    changed = [path for path, value in answer["values"].items() if value != answer["default_values"][path]]
    assert changed and all(path in terminal for path in changed)
    for line in dict.fromkeys(commands_on(terminal) + commands_on(page)):
        street.run(line)


@pytest.mark.slow
def test_from_make_tune_photographs_to_every_command_that_it_names(tmp_path):
    street = Street(tmp_path, SMALL | {"budget": BUDGET})
    terminal = street.run(recipe("tune-photographs", "tune"))
    street.run("gatetune mission view runs/tune")  # the target's second line
    answer = json.loads(street.run("gatetune campaign status runs/tune --json"))["recommendation"]
    page = street.file("runs/tune/report.html")
    says_what_is_known(answer, terminal, page)
    recommended = same_everywhere(street, answer)
    street.run("gatetune export runs/tune --to scoring.yaml", code=2)  # it would carry nothing
    for command, against in (("evaluate", "Hyb-H"), ("confirm", "default")):
        found = json.loads(street.run(f"gatetune {command} runs/tune --json"))
        plan = yaml.safe_load(street.file(found["directory"] + "/evaluation.yaml"))
        assert config_from_dict(plan["strategies"]["tuned"]).digest() == recommended
        gives_two_verdicts(found, answer, against)
    lines = list(dict.fromkeys(commands_on(terminal) + commands_on(page)))
    assert lines, "the page says what to do next"
    for line in lines:
        street.run(line)


def says_what_is_known(answer: dict, terminal: str, page: str) -> None:
    """Photographs are counts without an interval, on both screens, in a surveyor's words."""
    photographs, default = answer["mean"], answer["default_mean"]
    assert photographs == int(photographs) < default == 32
    assert answer["improvement_interval_95"] == [default - photographs] * 2
    for screen in (terminal, page):
        assert f"The number of photographs is {photographs:.0f} in place of 32" in screen
        assert not re.search(r"\d ?± ?0\.0\b|\+(\d+\.?\d*) to \+\1\b", screen)
        assert re.search(r"\d+ photographs (on a ring )?at \d+°", screen)
    for word in ("surrogate", "calibrated", "eligible"):
        assert word not in terminal


def same_everywhere(street: Street, answer: dict) -> str:
    """The same values in JSON, file, Python and every export; the digest of the configuration."""
    assert answer["values"] == json.loads(street.file("runs/tune/recommendation.json"))["values"]
    campaign = Campaign.open(street.folder / "runs/tune", read_only=True)
    assert answer["values"] == campaign.recommendation(save=False).values != answer["default_values"]
    street.run("gatetune export runs/tune")
    for to in ("unified_mission.yaml", "gatetune.yaml", "csv"):
        street.run(f"gatetune export runs/tune --to {to}")
    street.run(f"gatetune export runs/tune --to plan --home 47.4,8.5 --rock {campaign.settings.rocks[0]}")
    exported = config_from_dict(yaml.safe_load(street.file("runs/tune/gatetune.yaml")))
    s = campaign.settings
    assert exported.digest() == s.problem.config(answer["values"], s.conditions[0].name).digest()
    return campaign.recommended_config().digest()


def gives_two_verdicts(found: dict, answer: dict, against: str) -> None:
    """Photographs saved, quality kept or not, and the limit; controls at the same number."""
    lines = [line["text"] for line in found["verdicts"]]
    assert lines[0] == f"Photographs: {answer['mean']:.0f}, and 32 for {against}."
    assert against in lines[1] and lines[2].startswith("Constraint ")
    rows = {row["metric"]["key"]: row["cells"] for row in found["summary"]["rows"]}
    assert {"costs.images", "limit"} <= rows.keys()
    planned = {name: cell["mean"] for name, cell in rows["costs.images"].items()}
    assert {number for name, number in planned.items() if name not in ("hyb-h", "default")} == {
        answer["mean"]
    }
