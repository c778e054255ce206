"""Light and noise that cannot be are refused with the name of the parameter."""

from __future__ import annotations

import pytest

from nbv.config import MissionConfig
from nbv.errors import UserError


@pytest.mark.parametrize(
    ("path", "value"),
    [
        ("scene.read_noise_dn", -1.0),
        ("scene.shot_noise_dn", -0.1),
        ("scene.ambient", -0.2),
        ("scene.sky_grey", 1.5),
        ("scene.sun_direction", [0.0, 0.5, 0.5]),
    ],
)
def test_impossible_values_are_user_errors(path, value):
    with pytest.raises(UserError, match=path.replace(".", r"\.")):
        MissionConfig().with_values({path: value})
