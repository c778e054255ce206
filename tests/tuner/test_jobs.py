import csv
import importlib
import inspect
import re
from pathlib import Path
from typing import Any

import pytest

import tuner
from nbv.errors import UserError
from tuner.answer.answer import ANSWER_FILE, answer_of
from tuner.campaign.begin import begin_campaign
from tuner.campaign.settings_file import merged_settings, resolved_settings
from tuner.export.table import write_missions

API = Path(__file__).resolve().parents[2] / "docs" / "reference" / "api.md"
SMALL = {"photographs": 26}


def stable_names() -> list[str]:
    rows = [line for line in API.read_text().splitlines() if line.startswith("|`")]
    return [name for row in rows for name in re.findall(r"`((?:tuner|nbv)\.[\w.]+)`", row.split("|")[1])]


def test_every_exported_name_is_on_the_page() -> None:
    assert {f"tuner.{name}" for name in tuner.__all__} <= set(stable_names())


@pytest.mark.parametrize("name", stable_names())
def test_a_stable_name_is_there_and_documented(name: str) -> None:
    module, _, attribute = name.rpartition(".")
    assert inspect.getdoc(getattr(importlib.import_module(module), attribute))


EVENTS: list[float | None] = []


@pytest.fixture(scope="module")
def campaign(tmp_path_factory: pytest.TempPathFactory) -> tuner.Campaign:
    def hear(event: Any) -> None:
        if event.kind == "finished":
            EVENTS.append(event.trial.raw)

    asked = {"space": "gate_and_weights", "budget": 3, "overrides": SMALL}
    how = {"sampler": "sobol", "fidelity": "geometric", "workers": 1, "on_event": hear}
    return tuner.tune(tmp_path_factory.mktemp("jobs") / "first", rocks=["slab"], **asked, **how)


def rows(source: Any, path: Path) -> list[dict[str, str]]:
    with write_missions(source, path).open() as file:
        return list(csv.DictReader(file))


def test_a_campaign_becomes_a_table_and_a_callback_hears_of_every_mission(
    campaign: tuner.Campaign, tmp_path: Path
) -> None:
    table, trials = rows(campaign, tmp_path / "missions.csv"), campaign.trials()
    assert [trial.raw for trial in trials] == EVENTS
    assert [float(row["value"]) for row in table] == [trial.raw for trial in trials]
    assert [float(row["config.gate.d95_m"]) for row in table] == [t.values["gate.d95_m"] for t in trials]
    assert [row["metrics.observable.f_score_48mm"] for row in table] == [row["value"] for row in table]
    assert {row["costs.images"] for row in table} == {"26.0"}


def test_a_campaign_that_is_there_is_gone_on_with(campaign: tuner.Campaign) -> None:
    again = tuner.tune(campaign.directory, workers=1)
    assert [t.record.finished for t in again.trials()] == [t.record.finished for t in campaign.trials()]
    with pytest.raises(UserError, match="other settings: rocks"):
        tuner.tune(campaign.directory, rocks=["boulder"], space="gate_and_weights", budget=3)


def test_another_objective_does_not_keep_the_constraint(tmp_path: Path) -> None:
    asked = {"name": "c", "rocks": ["slab"], "fidelity": "geometric", "objective": "photographs@f_score>=97"}
    begun = begin_campaign(tmp_path, resolved_settings(asked, "test"))
    with pytest.raises(UserError, match=r"other settings: second is .* not None"):
        tuner.tune(begun.directory, objective="photographs")
    other = merged_settings(tmp_path / "campaign.yaml", {"objective": "seconds"}, quick=False)
    assert str(resolved_settings(other, "test").goal) == "seconds"


@pytest.mark.parametrize(
    ("wrong", "says"),
    [
        ({"budget": 0}, "at least 1"),
        ({"rocks": "slab"}, "it must be a list"),
        ({"rocks": [1]}, "rocks is 1; it must be a text"),
        ({"bugdet": 4}, "'budget'"),
    ],
)
def test_a_wrong_argument_is_one_clear_error(wrong: dict[str, Any], says: str, tmp_path: Path) -> None:
    with pytest.raises(UserError, match=says):
        tuner.tune(tmp_path / "c", **wrong)
    assert not (tmp_path / "c").exists()


def test_evaluation_and_reproduction(campaign: tuner.Campaign, tmp_path: Path) -> None:
    options = {"fidelity": "geometric", "workers": 1}
    run = tuner.evaluate(
        campaign, rocks=["arch"], strategies=["hyb-h"], replicates=1, directory=tmp_path / "e", **options
    )
    assert run.complete
    assert repr(run) == "EvaluationRun(tuned-gate, hyb-h on arch: 2 missions, 0 failed, complete)"
    evaluated = rows(run, tmp_path / "e.csv")
    assert {"tuned-gate", "hyb-h"} <= {row["strategy"] for row in evaluated}
    assert all(50 < float(row["metrics.observable.f_score_48mm"]) < 100 for row in evaluated)
    with pytest.raises(UserError, match="was tuned on"):
        tuner.evaluate(campaign, rocks=["slab"], **options)
    table = tuner.reproduce(
        tmp_path / "t", rocks=["slab"], strategies=["covis", "hyb-h"], overrides=SMALL, **options
    )
    assert [trial.strategy for trial in table.records] == ["covis", "hyb-h"]


def test_a_campaign_with_compare_on_ends_in_its_comparison(tmp_path: Path) -> None:
    asked = {"rocks": ["slab"], "compare_on": ["arch"], "space": "gate", "budget": 3, "sampler": "sobol"}
    campaign = tuner.tune(tmp_path / "c", fidelity="geometric", overrides=SMALL, workers=1, **asked)
    assert [table.targets for table in answer_of(campaign).tables] == [("arch",), ("slab",)]
    assert (tmp_path / "c" / ANSWER_FILE).is_file() and (tmp_path / "c" / "report.html").is_file()
    with pytest.raises(UserError, match="slab is tuned on and compared on"):
        tuner.tune(tmp_path / "d", **{**asked, "compare_on": ["slab"]})
