"""Missions over photographs that were really taken: the loop, scorers and gates of any mission, nothing rendered.

Each photograph of the set can be taken once, at its own place. How the photographer moved is unknown, so the flight is
nominal: straight legs between the places, without arrival errors.
"""

from __future__ import annotations

from dataclasses import replace
from operator import attrgetter
from typing import Any

import numpy as np

from nbv.config import MissionConfig, preset
from nbv.config.presets import PHOTOGRAPH_SET_DEFAULTS
from nbv.evaluation import Evaluation
from nbv.gates import GroundTruthOracle
from nbv.mission.fidelity import MissionContext
from nbv.mission.run_directory import LOCATED, RunDirectory
from nbv.photogrammetric.cloud_fidelity import CloudFidelity
from nbv.photogrammetric.reconstructor import PhotogrammetricReconstructor
from nbv.photographs.camera import PhotographCamera
from nbv.photographs.evaluation import MARGIN, measure_cloud
from nbv.photographs.photograph_set import PhotographSet
from nbv.photographs.viewpoints import SEED_CAP_DEG, PhotographViewpoints
from nbv.types import Cloud

VOXEL = 0.005  # of the height, where that is more than the configuration's voxel
ROOM_M = 0.3  # about the object, in which depths are sought
NOMINAL = "nominal: straight legs between places where a hand held the camera"


class PhotographFidelity(CloudFidelity):
    """Photographs of a set, each from where it was taken."""

    name = "photographs"
    unnoticed = (
        *("pool.lateral_", "pool.upper_", "pool.max_travel_m", "pool.min_spacing_m"),
        *("pool.revisit_exclusion_m", "pool.azimuth_sectors", "pool.max_candidates"),
        *("flight.arrival_tolerance_m", "flight.min_camera_altitude_m"),
        *("evaluation.crop_half_extent_m", "evaluation.ground_"),
        # The conditions under which the photographs were taken.
        *("scene.", "sensor.", "wind.", "target.", "camera.", "target_m"),
    )
    under_conditions = False
    follows_size = False  # the set says where its object is and how large
    viewpoints: PhotographViewpoints
    camera: PhotographCamera
    evaluation_code = "nbv.photographs"

    def __init__(self, context: MissionContext) -> None:
        super().__init__(context)
        config, key = context.config, context.rock.sha256
        self.photographs = PhotographSet.read(context.rock.name)
        self.viewpoints = PhotographViewpoints(
            np.array([p.camera_center_m for p in self.photographs.registered]),
            self.photographs.target_m,
            config,
            key,
            context.replicate,
        )
        self.vehicle_config = config_for_set(config, self.photographs)
        self.camera = PhotographCamera(context, self.photographs, self.viewpoints)
        margin_m = MARGIN * self.photographs.height_m
        x_m, y_m, z_m = (extent_m / 2 + margin_m for extent_m in self.photographs.extents_m)
        self.reconstructor = PhotogrammetricReconstructor(
            self.vehicle_config,
            context.store,
            keep_sparse=context.keeps_everything,
            half_extents_m=(x_m, y_m, z_m),
            stopwatch=context.stopwatch,
        )
        self.facts = {
            "photographs": len(self.photographs.registered),
            "seed_cap_deg": SEED_CAP_DEG,
            "flight_time": NOMINAL,
        }

    def oracle(self) -> GroundTruthOracle:
        rock = self.context.rock
        return GroundTruthOracle(rock.vertices_m, rock.faces, self.vehicle_config)

    def evaluate(self, cloud: Cloud) -> Evaluation:
        return measure_cloud(cloud, self.photographs, self.vehicle_config.evaluation)

    def evaluation_inputs(self) -> list[Any]:
        return [self.context.rock.sha256, self.vehicle_config.evaluation]

    def measure(self, cloud: Cloud) -> dict[str, Any]:
        return {**super().measure(cloud), "taken": list(self.camera.taken)}

    def export(self, run: RunDirectory, metrics: dict[str, Any]) -> None:
        run.write_config(self.vehicle_config.to_dict(), LOCATED)
        super().export(run, metrics)


def config_for_set(config: MissionConfig, photographs: PhotographSet) -> MissionConfig:
    """``config`` with the set's camera and object, a crop that holds the object, and arrivals without error.

    Where it has its preset's value, `PHOTOGRAPH_SET_DEFAULTS` hold: in preset ``photographs``, which has them itself, all stands.
    """
    half_m = max(photographs.height_m, *photographs.extents_m) / 2 + ROOM_M
    usual = preset(config.preset)
    unchosen = {
        p: value
        for p, value in PHOTOGRAPH_SET_DEFAULTS.items()
        if attrgetter(p)(config) == attrgetter(p)(usual)
    }
    config = config.with_values(
        {
            **unchosen,
            "flight.arrival_tolerance_m": 0.0,
            "flight.min_camera_altitude_m": 0.0,
            "shared.box_half_extent_m": max(config.shared.box_half_extent_m, half_m),
            "dense.crop_half_width_m": max(config.dense.crop_half_width_m, half_m),
            "dense.fusion_voxel_m": max(config.dense.fusion_voxel_m, VOXEL * photographs.height_m),
        }
    )
    return replace(config, camera=photographs.camera, target_m=photographs.target_m)


# Run one mission over the photographs of the set ``rock`` and measure its cloud: a `nbv.mission.MissionFunction`.
run_photographs_mission = PhotographFidelity.run
