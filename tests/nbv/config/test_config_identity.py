"""A configuration's digest: what results are found by again."""

from __future__ import annotations

import pytest

from nbv.config import MissionConfig, config_from_dict, preset
from nbv.errors import UserError


def test_the_campaign_preset_is_what_all_campaigns_flew() -> None:
    assert preset("campaign").digest() == "ebb0509a42ffd52d"


@pytest.mark.parametrize("name", ["main_term", "matchable_views"])
def test_a_file_with_an_old_name_is_told_the_new_one(name: str) -> None:
    new = {"main_term": "gate.geometry_scorer", "matchable_views": "matchable.views"}[name]
    with pytest.raises(UserError, match=f"b_aware.{name} of an earlier version is now {new}"):
        config_from_dict({"b_aware": {name: 6}})
    with pytest.raises(UserError, match=new):
        preset("campaign").with_values({f"b_aware.{name}": 6})


def test_names_are_checked_when_a_configuration_is_read() -> None:
    with pytest.raises(UserError, match=r"gate\.kind is 'hybh'; allowed: covis, b-aware, .*hyb-h"):
        MissionConfig().with_values({"gate.kind": "hybh"})
    with pytest.raises(UserError, match=r"gate\.geometry_scorer is 'hyb-h'; allowed: covis"):
        MissionConfig().with_values({"gate.geometry_scorer": "hyb-h"})


def test_a_retired_setting_is_read_at_the_value_that_stayed_and_refused_at_another() -> None:
    assert config_from_dict({"visibility": {"mode": "frustum"}}) == MissionConfig()
    assert preset("campaign").with_values({"visibility.mode": "frustum"}) == preset("campaign")
    with pytest.raises(UserError, match=r"^visibility\.mode is gone: .* not 'occlusion'"):
        config_from_dict({"visibility": {"mode": "occlusion"}})
    with pytest.raises(UserError, match=r"^visibility\.mode is gone"):
        preset("campaign").with_values({"visibility.mode": "occlusion"})
    with pytest.raises(UserError, match=r"unknown mission parameter 'visibility\.range_m'"):
        config_from_dict({"visibility": {"range_m": 1}})
