"""Named worlds laid over a configuration."""

import re
from pathlib import Path

import pytest
from refusals import refused

from nbv.config import (
    TELEMETRY_LEVELS,
    config_from_dict,
    load_condition,
    load_conditions,
    preset,
    shipped_files,
    under,
)
from nbv.errors import UserError


def written(folder: Path, text: str, name: str = "own.yaml") -> str:
    (folder / name).write_text(text)
    return str(folder / name)


def test_ideal_is_the_very_same_configuration() -> None:
    config = preset("campaign").with_values({"telemetry": "rtk"})
    assert under(config, load_condition("ideal")) is config


def test_all_shipped_conditions_are_worlds_of_their_own() -> None:
    names = list(shipped_files("conditions"))
    assert {"ideal", "lunar-day", "low-sun", "field", "harsh"} <= set(names)
    configs = [under(preset("campaign"), load_condition(name)) for name in names]
    assert len({config.digest() for config in configs}) == len(names)
    assert [config.condition for config in configs] == names
    assert all(load_condition(name).description for name in names)


def test_a_condition_changes_what_it_names_and_nothing_else(tmp_path: Path) -> None:
    own = load_condition(written(tmp_path, "telemetry: gnss\nscene: {ambient: 0.1}\n"))
    base = preset("campaign").with_values({"scene.sky_grey": 0.2})
    changed = under(base, own)
    expected = base.with_values({"telemetry": "gnss", "scene.ambient": 0.1, "condition": "own"})
    assert changed == expected and changed.telemetry == TELEMETRY_LEVELS["gnss"]
    assert config_from_dict(changed.to_dict()) == changed
    assert set(own.paths) >= {"scene.ambient", "telemetry.drift_m"}


def test_under_one_condition_there_is_no_second() -> None:
    with pytest.raises(UserError, match="under condition 'low-sun' already"):
        under(under(preset("campaign"), load_condition("low-sun")), load_condition("field"))


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("scene: {ambiant: 0.1}", "unknown mission parameter 'scene.ambiant'; did you mean 'scene.ambient'"),
        ("scene: 3", "scene is 3; it must map names to values"),
        ("dense: {agreeing_views: 3}", "dense is no part of the environment; a condition sets scene"),
        ("telemetri: gnss", "a condition has no section 'telemetri'; did you mean 'telemetry'"),
        ("telemetry: gps", "unknown telemetry level 'gps'; there are exact, rtk"),
        ("- scene", "a condition maps sections to fields"),
        ("description: 3", "description is 3; it must be a text"),
    ],
)
def test_a_mistake_in_a_file_is_one_clear_line(tmp_path: Path, text: str, said: str) -> None:
    path = written(tmp_path, text)
    assert path in refused(re.escape(said), load_condition, path)


def test_a_condition_that_there_is_not_is_told(tmp_path: Path) -> None:
    refused(r"unknown condition 'feild'; there are ideal, .*or give a YAML file", load_condition, "feild")
    refused("cannot read", load_condition, str(tmp_path / "nowhere.yaml"))
    with pytest.raises(UserError, match="ideal is the name of the default environment"):
        load_condition(written(tmp_path, "telemetry: gnss", "ideal.yaml"))
    refused("cannot name a condition", load_condition, written(tmp_path, "telemetry: gnss", "a world.yaml"))
    refused("'field' is named twice", load_conditions, ["field", "field"])
    refused("no condition to run under", load_conditions, [])
