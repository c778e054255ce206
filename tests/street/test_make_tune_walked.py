"""`make tune` in small, and the whole way on from it: one recommendation, the same values wherever they stand."""

import json
import re

import pytest
import yaml
from street import ROOT, SMALL, Street, commands_on

from nbv.config import config_from_dict
from tuner.campaign.campaign import Campaign

BUDGET = "24"


@pytest.mark.slow
def test_from_make_tune_to_every_command_that_it_names(tmp_path):
    street = Street(tmp_path, SMALL | {"budget": BUDGET})
    recipe = re.search(r"campaign run (--quick.*)", (ROOT / "Makefile").read_text())[1]
    terminal = street.run("gatetune campaign run " + recipe.replace("$(RUN)", "tune"))
    answer = json.loads(street.run("gatetune campaign status runs/tune --json"))["recommendation"]
    page = street.file("runs/tune/report.html")
    says_what_is_known(answer, terminal, page)
    recommended = same_everywhere(street, answer)
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
        assert f"Photographs: {photographs:.0f} in place of 32" in screen
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
    street.run("gatetune export runs/tune --to plan --home 47.4,8.5")
    street.run("gatetune export runs/tune --to scoring.yaml", code=2)  # it would carry nothing
    exported = config_from_dict(yaml.safe_load(street.file("runs/tune/gatetune.yaml")))
    assert exported.digest() == campaign.recommended_config().digest()
    return exported.digest()


def gives_two_verdicts(found: dict, answer: dict, against: str) -> None:
    """Photographs saved, quality kept or not, and the limit; controls at the same number."""
    lines = [line["text"] for line in found["verdicts"]]
    assert lines[0] == f"Photographs: {answer['mean']:.0f} in place of 32 of {against}."
    assert against in lines[1] and lines[2].startswith("Limit ")
    rows = {row["metric"]["label"]: row["cells"] for row in found["summary"]["rows"]}
    assert {"Photographs", "Limit kept"} <= rows.keys()
    planned = {name: cell["mean"] for name, cell in rows["Photographs"].items()}
    assert {number for name, number in planned.items() if name not in ("hyb-h", "default")} == {
        answer["mean"]
    }
