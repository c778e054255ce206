"""The Python API: jobs, stable names, missions as a function, and what is refused before anything runs."""

import csv
import importlib
import inspect
import math
import re
from pathlib import Path
from typing import Any

import pytest
from refusals import refused

import tuner
from nbv.errors import UserError
from nbv.geometric import run_geometric_mission
from nbv.mission import MissionResult
from tuner.campaign.begin import begin_campaign
from tuner.campaign.settings_file import merged_settings, resolved_settings
from tuner.export.table import write_missions

API = Path(__file__).resolve().parents[2] / "docs" / "reference" / "api.md"
SMALL = {"photographs": 26}


def stable_names() -> list[str]:
    rows = [line for line in API.read_text().splitlines() if line.startswith("|`")]
    return [name for row in rows for name in re.findall(r"`((?:tuner|nbv)\.[\w.]+)`", row.split("|")[1])]


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


def test_a_campaign_becomes_a_table_and_a_callback_hears_of_every_mission(campaign, tmp_path):
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
    refused(r"other settings: second is .* not None", tuner.tune, begun.directory, objective="photographs")
    other = merged_settings(tmp_path / "campaign.yaml", {"objective": "seconds"}, quick=False)
    assert str(resolved_settings(other, "test").goal) == "seconds"


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
    refused("was tuned on", tuner.evaluate, campaign, rocks=["slab"], **options)
    table = tuner.reproduce(
        tmp_path / "t", rocks=["slab"], strategies=["covis", "hyb-h"], overrides=SMALL, **options
    )
    assert [trial.strategy for trial in table.records] == ["covis", "hyb-h"]


EXAMPLES = dict(re.findall(r'```python title="(\w+)"\n(.*?)```', API.read_text(), re.DOTALL))
SHORT = {"overrides": {"photographs": 26}}


def test_it_is_the_mean_of_the_missions():
    f = tuner.objective("gate_and_weights", ["slab", "boulder"], replicates=2, **SHORT)
    config = f.settings.problem.config(f.default)
    missions = [run_geometric_mission(config, rock, k) for rock in ("slab", "boulder") for k in (0, 1)]
    mean = sum(m.metric(f.settings.objective.metric) for m in missions) / 4
    assert f({}) == f(f.default) == pytest.approx(mean, abs=1e-9)
    assert f([f.default[name] for name in f.names]) == pytest.approx(mean, abs=1e-9)


def test_bounds_and_names_are_those_of_the_space():
    f = tuner.objective("plan_and_gate", ["slab"])
    parameters = f.settings.space.parameters
    for p, name, (low, high) in zip(parameters, f.names, f.bounds, strict=True):
        assert name == p.path and name in f.optuna_distributions()
        if p.kind == "categorical":
            assert (low, high) == (0, len(p.choices) - 1)
            assert f._by_path([b[1] for b in f.bounds])[name] == p.choices[-1]
        else:
            assert (low, high) == (p.low, p.high)


def test_a_failed_mission_and_a_mistake(monkeypatch):
    def fails(config, rock, replicate, directory):
        return MissionResult("failed", "seeds", "", config.digest(), rock, replicate, {}, [], {}, {})

    monkeypatch.setattr("tuner.comparison.objective.kind_on", lambda rock, fidelity: fails)
    assert math.isnan(tuner.objective("gate", ["slab"])({}))
    f = tuner.objective("gate", ["slab"], failed=-1.0)
    assert f({}) == -1.0
    refused(r"'gate\.d96_m' is not in the search space; it has gate", f, {"gate.d96_m": 1.0})
    refused("there are 2 parameters", f, [1.0])
    with pytest.raises(UserError, match=r"would not keep the limit on costs\.images; make a function"):
        tuner.objective("photographs", ["slab"], objective="f_score@photographs<=20")
    plan = tuner.objective("plan_and_gate", ["slab"])
    many = len(plan.names)
    for wrong in ([math.nan] * many, [99.0] * many, {"seeds": 10**9}, {"seeds": "x"}):
        refused(r"outside of the search space: ", plan, wrong)


@pytest.mark.slow
@pytest.mark.parametrize("title", EXAMPLES)
def test_the_page_s_examples_run(title, capsys):
    exec(compile(EXAMPLES[title], title, "exec"), {})
    assert capsys.readouterr().out


HIGH = {"flight.min_camera_altitude_m": 1.6}  # above an orbit at 10°


@pytest.mark.parametrize(
    ("asked", "named"),
    [
        ({"space": "gate", "overrides": HIGH}, "strategy orbit cannot run"),
        ({"space": "plan_and_gate", "overrides": HIGH}, "strategy orbit cannot run"),
        ({"space": "gate", "overrides": {"photographs": 20}}, "seeds is 24, more than the 20 photographs"),
        ({"space": "gate", "compare_on": ["nowhere"]}, "unknown rock 'nowhere'"),
        ({"space": "gate", "compare_on": ["slab"]}, "slab is tuned on and compared on"),
        ({"space": "gate", "fidelity": "photographs", "compare_on": []}, "cannot run on slab"),
    ],
)
def test_a_campaign_whose_comparison_cannot_run(tmp_path: Path, asked: dict[str, Any], named: str) -> None:
    settings = {"rocks": ["slab"], "compare_on": ["arch"], "fidelity": "geometric", "budget": 3, **asked}
    refused(named, tuner.tune, tmp_path / "run", workers=1, **settings)
    assert not (tmp_path / "run").exists()
