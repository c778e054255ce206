"""Every parameter says what it is and where its default comes from; presets change only what they say."""

import pytest

from nbv.config import PRESETS, MissionConfig, parameters, preset


@pytest.mark.parametrize("path", parameters())
def test_a_parameter_has_a_meaning_and_a_source(path: str) -> None:
    about = parameters()[path]
    assert about.meaning
    assert about.source in ("text", "code", "gatetune")
    assert about.reason or about.source == "gatetune"  # the place in the paper or the public code


def test_the_paper_s_preset_is_the_defaults_and_changes_nothing() -> None:
    assert preset("paper") == MissionConfig()
    assert PRESETS["paper"].values == {}
    reduced = {path.split(".")[0] for path in PRESETS["paper-reduced"].values}
    assert reduced == {"sparse", "dense"}  # the same flight rules, scorers, gate and metrics
