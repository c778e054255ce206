import math
import re
from pathlib import Path

import pytest

import tuner
from nbv.errors import UserError
from nbv.geometric import run_geometric_mission
from nbv.mission import MissionResult

PAGE = Path(__file__).resolve().parents[3] / "docs/reference/api.md"
EXAMPLES = dict(re.findall(r'```python title="(\w+)"\n(.*?)```', PAGE.read_text(), re.DOTALL))
SMALL = {"overrides": {"photographs": 26}}


def test_it_is_the_mean_of_the_missions():
    f = tuner.objective("gate_and_weights", ["slab", "boulder"], replicates=2, **SMALL)
    config = f.settings.problem.config(f.default)
    missions = [run_geometric_mission(config, rock, k) for rock in ("slab", "boulder") for k in (0, 1)]
    mean = sum(m.metric(f.settings.objective.metric) for m in missions) / 4
    assert f({}) == f(f.default) == pytest.approx(mean, abs=1e-9)
    assert f([f.default[name] for name in f.names]) == pytest.approx(mean, abs=1e-9)


def test_bounds_and_names_are_those_of_the_space():
    f = tuner.objective("plan_and_gate", ["slab"])
    parameters = f.settings.space.parameters
    for p, name, (low, high), ax in zip(parameters, f.names, f.bounds, f.ax_parameters(), strict=True):
        assert name == p.path == ax["name"] and name in f.optuna_distributions()
        if p.kind == "categorical":
            assert (low, high) == (0, len(p.choices) - 1) and ax["values"] == list(p.choices)
            assert f._by_path([b[1] for b in f.bounds])[name] == p.choices[-1]
        else:
            assert (low, high) == (p.low, p.high) and ax["bounds"] == [p.low, p.high]


def test_a_failed_mission_and_a_mistake(monkeypatch):
    def fails(config, rock, replicate, directory):
        return MissionResult("failed", "seeds", "", config.digest(), rock, replicate, {}, [], {}, {})

    monkeypatch.setattr("tuner.comparison.objective.kind_on", lambda rock, fidelity: fails)
    assert math.isnan(tuner.objective("gate", ["slab"])({}))
    f = tuner.objective("gate", ["slab"], failed=-1.0)
    assert f({}) == -1.0
    with pytest.raises(UserError, match=r"'gate\.d96_m' is not in the search space; it has gate"):
        f({"gate.d96_m": 1.0})
    with pytest.raises(UserError, match="there are 2 parameters"):
        f([1.0])
    with pytest.raises(UserError, match=r"would not keep the limit on costs\.images; make a function"):
        tuner.objective("photographs", ["slab"], objective="f_score@photographs<=20")
    plan = tuner.objective("plan_and_gate", ["slab"])
    many = len(plan.names)
    for wrong in ([math.nan] * many, [99.0] * many, {"seeds": 10**9}, {"seeds": "x"}):
        with pytest.raises(UserError, match=r"outside of the search space: "):
            plan(wrong)


@pytest.mark.slow
@pytest.mark.parametrize("title", EXAMPLES)
def test_the_page_s_examples_run(title, capsys):
    exec(compile(EXAMPLES[title], title, "exec"), {})
    assert capsys.readouterr().out
