"""The named configurations that a user starts from."""

from __future__ import annotations

import functools
from dataclasses import dataclass, field
from typing import Any

from nbv.config.declaration import Origin
from nbv.config.mission_config import MissionConfig
from nbv.errors import UserError

# Work left out that the outcome does not show (docs/results/index.md).
_REDUCED_SFM: dict[str, Any] = {
    "sparse.max_pairs": 8,
    "sparse.max_pair_angle_deg": 130.0,
    "sparse.min_ransac_trials": 30,  # nine matches of ten are right; where fewer are, COLMAP goes on by itself
    "sparse.global_ba_interval": 20,
    "sparse.local_ba_images": 3,
    "sparse.local_ba_rounds": 1,
    "sparse.local_ba_iterations": 2,
    "sparse.global_ba_iterations": 1,
    "sparse.update_pairs": "near",
}
# Not in a dim hall: where the sparse model has few points, the cloud ends with them.
_REDUCED: dict[str, Any] = {
    **_REDUCED_SFM,
    "dense.min_baseline_angle_deg": 40.0,
    "dense.search": "sparse",
}

# Work is left out that scores do not show; photographs of 1280 px take the dense stage ten times as long, and fewer of their
# depths agree: they are not sharp to a pixel; and six views of 24 to 32 seldom see one place (docs/results/index.md).
PHOTOGRAPH_SET_DEFAULTS: dict[str, Any] = {
    **_REDUCED,
    "sparse.max_features": 2048,
    "sparse.min_registered_seeds": 3,  # that a model can be aligned by: photographs that do not register are an outcome
    "dense.max_size_px": 480,
    "dense.agreeing_views": 3,
}

# Chosen by the noise of missions on training rocks: docs/results/index.md.
_CAMPAIGN: dict[str, Any] = {
    "photographs": 32,
    "stop.criterion": "budget",
    "stop.knn_region": "box",  # far ground points would drown the rock in the statistic
    "sparse.first_octave": 0,
    "sparse.max_features": 4096,
    "sparse.max_pairs": 24,
    "sparse.max_pair_angle_deg": 130.0,
    "dense.agreeing_views": 6,
    "evaluation.gt_samples": 50_000,
}

_PAPER_CODE: dict[str, Any] = {
    "pool.min_altitude_m": 1.5,  # rejects the whole 10 degree ring
    "b_aware.alpha_track": 0.5,
    "b_aware.alpha_density": 0.3,
    "b_aware.alpha_reprojection": 0.2,
    "stop.criterion": "budget",
    "gate.oracle_coverage": "paper-code",
    "sparse.max_features": 16384,
    "evaluation.gt_gate_m": 0.05,
}


@dataclass(frozen=True)
class Preset:
    """The default configuration with some values changed."""

    purpose: str  # one line
    source: Origin  # of the changed values
    values: dict[str, Any] = field(default_factory=dict)  # by parameter path


PRESETS = {
    "paper": Preset("the paper's text; every pair of photographs is matched", "text"),
    "paper-reduced": Preset("the same missions with reduced SfM, for speed", "gatetune", _REDUCED),
    "paper-code": Preset(
        "what the authors' public code executes where it departs from the text",
        "code",
        _PAPER_CODE,
    ),
    "campaign": Preset(
        "for tuning: few captures and strict agreement, so that configurations can be told apart",
        "gatetune",
        _CAMPAIGN,
    ),
    "campaign-reduced": Preset(
        "`campaign` with reduced SfM, for speed: the missions of `make tune`",
        "gatetune",
        {**_CAMPAIGN, **_REDUCED_SFM},
    ),
    "photographs": Preset(
        "`campaign` for sets of photographs, where it is the default",
        "gatetune",
        {**_CAMPAIGN, **PHOTOGRAPH_SET_DEFAULTS},
    ),
}


@functools.cache
def preset(name: str) -> MissionConfig:
    """The preset called ``name``; ``UserError`` if there is none."""
    if name not in PRESETS:
        raise UserError(f"unknown preset {name!r}; there are {', '.join(PRESETS)}")
    return MissionConfig(preset=name).with_values(PRESETS[name].values)
