from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from refusals import refused

from nbv.config import MissionConfig, preset
from nbv.errors import UserError
from nbv.safe_files import parse_yaml
from nbv.viewpoints import RINGS
from tuner.problem.space_files import available_search_spaces, load_search_space, space_from_dict

MIXED = space_from_dict(
    {
        "name": "mixed",
        "parameters": {
            "gate.d95_m": {"kind": "float", "low": 0.01, "high": 1.0, "scale": "log"},
            "gate.budget_fraction": {"kind": "float", "low": 0.0, "high": 1.0},
            "b_aware.target_track_length": {"kind": "int", "low": 3, "high": 12},
            "dense.neighbours": {"kind": "int", "low": 1, "high": 64, "scale": "log"},
            "stop.knn_region": {"kind": "categorical", "choices": ["all", "box"]},
        },
    },
    "mixed.yaml",
)


def test_shipped_spaces_start_at_the_papers_values() -> None:
    gate = load_search_space("gate")
    assert gate.default(MissionConfig()) == {"gate.budget_fraction": 0.4, "gate.d95_m": 0.14}
    both, full = load_search_space("gate_and_weights"), load_search_space("full")
    default = both.default(preset("campaign"))
    assert (default["covis.weights.nov"], default["b_aware.weights.ang"]) == (1.2, 0.4)
    assert both.dimension == 8 and set(both.paths) < set(full.paths)
    assert len(full.categorical_dimensions) == 1 and len(full.discrete_dimensions) == 2
    pool = load_search_space("gate_weights_and_pool")
    assert set(pool.paths) - set(both.paths) == {"pool.max_altitude_m"}
    # Where the space begins nothing is filtered: the paper's pool.
    at = np.array([0.0, -4.0, 2.0]), np.zeros((0, 3))
    paper = preset("paper")
    unlimited = RINGS.candidates(paper, *at, 0)
    assert RINGS.candidates(pool.config(paper, pool.default(paper)), *at, 0).ids == unlimited.ids
    assert {"gate", "gate_and_weights", "paper_ten", "full"} <= set(available_search_spaces())


@pytest.mark.parametrize("name", available_search_spaces())
def test_every_point_of_the_shipped_spaces_is_a_mission(name: str) -> None:
    space = load_search_space(name).fitted(preset("campaign"))
    space.config(preset("campaign"), space.default(preset("campaign")))  # a campaign begins there
    rng = np.random.default_rng(0)
    corners = rng.integers(0, 2, (40, space.dimension)).astype(float)
    for position in [*corners, *rng.random((40, space.dimension))]:
        config = space.config(preset("campaign"), space.from_unit(position))  # raises if it is not
        assert config.b_aware.theta_low_deg < config.b_aware.theta_saturation_deg


@given(st.lists(st.floats(0, 1), min_size=5, max_size=5))
def test_unit_cube_round_trip(position: list[float]) -> None:
    values = MIXED.from_unit(position)
    assert all(p.contains(values[p.path]) for p in MIXED.parameters)
    unit = MIXED.to_unit(values)
    assert np.all((unit >= 0) & (unit <= 1))
    np.testing.assert_allclose(unit[:2], position[:2], atol=1e-9)  # floats come back
    again = MIXED.from_unit(unit)
    assert {k: again[k] for k in list(again)[2:]} == {k: values[k] for k in list(values)[2:]}
    np.testing.assert_allclose(again["gate.d95_m"], values["gate.d95_m"], rtol=1e-9)
    MissionConfig().with_values(values)  # and every point is a mission


D95 = "parameters:\n  gate.d95_m: "
EQUAL = "parameters:\n  seeds: {kind: int, low: 8, high: 30}\n"
GOOD = D95 + "{kind: float, low: 0.01, high: 1.0, scale: log}\n"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (D95 + "{low: 1.0, high: 0.1}", "low 1 is not below high 0.1"),
        (D95 + "{low: 0.0, high: 1.0, scale: log}", "scale log needs low above 0"),
        (D95 + "{lo: 0.1, high: 1.0}", "unknown key 'lo'; allowed: kind, low"),
        (D95 + "{low: 0.3, high: 1.0}", "has the default 0.14, outside"),
        (D95 + "{low: abc, high: 1.0}", "low is 'abc'; it must be a number"),
        (D95 + "{high: 1.0}", "gate.d95_m: 'low' is missing"),
        (D95 + "{low: 0.1, high: 1, scale: cubic}", "scale is 'cubic'; allowed: linear, log"),
        (D95 + "0.3", "give a mapping"),
        (D95 + "{low: 0.1, high: 1.0, also: gate.d95}", "also is 'gate.d95'; it must be a list"),
        (D95 + "{low: 0.1, high: 1.0, also: [gate.d95_m]}", "gate.d95_m is tuned twice"),
        (GOOD + "base:\n  gate.d95_m: 0.2", "both fixed in 'base' and tuned"),
        (GOOD + "begin: {gate.d95_m: 0.2}", "'begin' must list mappings"),
        (GOOD + "begin:\n  - {gate.d95_m: 7}", r"gate.d95_m is 7, outside of the search space: \[0.01, 1\]"),
        (GOOD + "begin:\n  - {photographs: 30}", "'photographs' is not in the search space"),
        ("parameters: {}", "at least one parameter"),
        ("", "mapping with the key 'parameters'"),
        ("parameters: {gate.d95: {low: 0.1, high: 1.0}}", r"unknown mission parameter 'gate.d95'; did you"),
        (
            "parameters: {gate.budget_fraction: {low: 0.0, high: 2.0}}",
            "gate.budget_fraction is 2.0; it must be a number of at most 1",
        ),
        ("parameters: {dense.neighbours: {kind: int, low: 1.5, high: 4}}", "whole number"),
        ("parameters: {stop.knn_region: {kind: categorical, choices: [all]}}", "at least two"),
    ],
)
def test_mistakes_are_named(text: str, message: str) -> None:
    with pytest.raises(UserError, match=message) as caught:
        space_from_dict(parse_yaml(text, "my.yaml"), "my.yaml").default(MissionConfig())
    assert "\n" not in str(caught.value) and ("my.yaml" in str(caught.value) or "'my'" in str(caught.value))


@pytest.mark.parametrize("value", ["7", ".nan", "hyb-h"])
def test_a_beginning_outside_is_refused_where_the_file_is_read(value: str) -> None:
    """A campaign leaves out beginnings that its settings exclude, so a mistake has to be named before."""
    text = GOOD + f"begin:\n  - {{gate.d95_m: {value}}}"
    refused(
        r"my.yaml: begin: gate.d95_m is .* outside", space_from_dict, parse_yaml(text, "my.yaml"), "my.yaml"
    )


def test_more_seeds_than_photographs_are_refused() -> None:
    space = space_from_dict(
        parse_yaml(EQUAL.replace("low: 8, high: 30", "low: 33, high: 40"), "my.yaml"), "my.yaml"
    )
    with pytest.raises(UserError, match=r"seeds begins at 33, and a mission takes 32 photographs; lower it"):
        space.fitted(preset("campaign"))


def test_beginnings_with_more_seeds_than_photographs_are_left_out_and_the_space_is_read_again() -> None:
    space = space_from_dict(parse_yaml(EQUAL + "begin: [{seeds: 28}, {seeds: 16}]", "my.yaml"), "my.yaml")
    fitted = space.fitted(preset("campaign").with_values({"photographs": 20, "seeds": 16}))
    assert fitted.begin == ({"seeds": 16},)
    assert space_from_dict(fitted.to_dict(), "campaign.yaml") == fitted


def test_no_more_seeds_than_photographs_are_drawn() -> None:
    """Where the number of photographs is searched, too, or is the space's own; with all of them seeds nothing is planned."""
    space = load_search_space("photographs").fitted(preset("campaign"))
    drawn = [space.from_unit(unit) for unit in np.random.default_rng(0).random((50, space.dimension))]
    assert all(space.config(preset("campaign"), values).planned_views >= 0 for values in drawn)
    orbits = [values for values in drawn if values["seeds"] == values["photographs"]]
    assert orbits and all(values["pool.max_altitude_m"] == 4.0 for values in orbits)
    text = "base: {photographs: 14, sparse.ground_features: 2000}\n" + EQUAL.replace(
        "high: 30", "high: 30, default: 12"
    )
    (seeds,) = space_from_dict(parse_yaml(text, "my.yaml"), "my.yaml").fitted(preset("paper")).parameters
    assert (seeds.high, seeds.default) == (14, 12)


def test_one_parameter_may_set_several_paths() -> None:
    shared = "{low: 0.1, high: 2.0, also: [predicted.weights.nov, covis.weights.nov]}"
    text = f"name: shared\nparameters:\n  b_aware.weights.nov: {shared}\n"
    space = space_from_dict(parse_yaml(text, "shared"), "shared")
    assert space.dimension == 1 and space_from_dict(space.to_dict(), "again") == space
    config = space.config(preset("paper"), {"b_aware.weights.nov": 0.7})
    novelty = {config.covis.weights.nov, config.b_aware.weights.nov, config.predicted.weights.nov}
    assert novelty == {0.7}


def test_files_that_cannot_be_read(tmp_path: Path) -> None:
    refused(
        "unknown search space 'gates'; there are full, gate, gate_and_weights,", load_search_space, "gates"
    )
    refused("cannot read", load_search_space, tmp_path / "none.yaml")
    (tmp_path / "binary.yaml").write_bytes(b"\xff\xfe\x00\x9f")
    refused(r"cannot read|not YAML", load_search_space, tmp_path / "binary.yaml")
    (tmp_path / "mine.yaml").write_text(GOOD)
    assert load_search_space(tmp_path / "mine.yaml").name == "mine"
