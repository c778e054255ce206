"""What given views would reconstruct, without planning anything."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from nbv.cache import Store
from nbv.config import MissionConfig
from nbv.errors import UserError
from nbv.flight import arrival_position
from nbv.geometric.completeness import sample_probability
from nbv.geometric.held_worlds import world_of
from nbv.geometric.metrics import predicted_metrics
from nbv.geometry.stereo_chance import DenseModel
from nbv.rocks import load_coarse_rock
from nbv.terrain import buried_rock
from nbv.viewpoints import raw_candidates, seed_viewpoints


def predict_views(
    config: MissionConfig, rock: str, chosen: Sequence[str], replicate: int = 0, *, cache: bool = True
) -> dict[str, Any]:
    """The predicted metrics of the seeds and the candidates ``chosen`` (ids).

    Raises
    ------
    UserError
        Unknown rock, or an id that is no candidate.
    """
    store = Store() if cache else None
    subject = buried_rock(load_coarse_rock(rock, store), config)
    world = world_of(subject, config, store)
    seeds = seed_viewpoints(config)
    viewpoints = {v.id: v for v in (*seeds, *raw_candidates(config))}
    unknown = [name for name in chosen if name not in viewpoints]
    if unknown:
        raise UserError(f"{unknown[0]!r} is no candidate; ids run from cand_000 upwards")
    names = [*(v.id for v in seeds), *chosen]
    centers_m = np.array(
        [arrival_position(viewpoints[n], config.flight, subject.sha256, replicate) for n in names]
    )
    rows = [world.index(name) for name in names]
    return predicted_metrics(world, sample_probability(world, rows, centers_m, config, DenseModel()), config)
