"""Missions over photographs that were really taken: the loop, scorers and gates of any mission, nothing rendered.

Each photograph of the set can be taken once, at its own place. How the photographer moved is unknown, so the flight is
nominal: straight legs between the places, without arrival errors.

A mission may look only from where a photograph was taken. Seeds are the photographs nearest, by direction from the object,
to the viewpoints that the configuration asks for; the pool is those that are not taken yet. Planner, scorers and gates see
their real positions.

There is no true surface, so a mission's cloud is measured against the set's dense reference. Scores have the names that they
have on rocks, and their meaning on a rock of 1.6 m: 48 mm stand for 3 % of the object's height. The cloud is registered first
(`nbv.evaluation.evaluate`). Only what lies within `MARGIN` of the reference's box and not below it counts, as in Tanks and
Temples, and what most masks show as the object. The ground plane is not removed: the reference has no ground, and part of a low
object may be a plane itself (a quarter of a mound of sand was lost so).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from operator import attrgetter
from typing import Any

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.spatial.distance import cdist

from nbv.config import EvaluationConfig, MissionConfig, preset
from nbv.config.presets import PHOTOGRAPH_SET_DEFAULTS
from nbv.errors import MissionFailure
from nbv.evaluation import Evaluation
from nbv.evaluation.cleaning import clean_cloud, select
from nbv.evaluation.evaluate import moved, register_cloud
from nbv.evaluation.ground_truth import GroundTruthSamples
from nbv.evaluation.registry import compute_metrics
from nbv.flight.telemetry import TelemetryErrors
from nbv.gates import GroundTruthOracle
from nbv.geometry.frames import angles_deg, azimuths_elevations_deg, directions_from, heading_to, unit_vectors
from nbv.geometry.visibility import nearest_neighbours
from nbv.mission.fidelity import MissionContext
from nbv.mission.run_directory import LOCATED, RunDirectory
from nbv.photogrammetric.photogrammetric_fidelity import CloudFidelity
from nbv.photogrammetric.reconstructor import PhotogrammetricReconstructor
from nbv.photographs.object_frame import IN_MASK
from nbv.photographs.photograph_set import THRESHOLD_FRACTIONS, PhotographSet, gaps_deg
from nbv.process import keyed_rng
from nbv.rocks import DEFAULT_HEIGHT_M
from nbv.types import Bools, Camera, CandidatePool, Capture, Cloud, Floats, Ints, PointCloud, Viewpoint
from nbv.viewpoints import ViewpointSource, seed_viewpoints

VOXEL = 0.005  # of the height, where that is more than the configuration's voxel
ROOM_M = 0.3  # about the object, in which depths are sought
NOMINAL = "nominal: straight legs between places where a hand held the camera"
SEED_CAP_DEG = 20.0  # a seed viewpoint without a photograph within this is left out
MOST_MISSING = (
    0.25  # of the seeds on sides that were photographed; more, and the set cannot express the layout
)
LEAST_AROUND = 0.4  # of the seeds are on sides that were photographed
UPPER_BAND_DEG = 35.0  # as in the paper's pool
MARGIN = 0.1  # of the height, about the reference's box
REACHES = (0.125, 0.06, 0.03)  # of correspondences, of the height: 0.2, 0.1 and 0.05 of a rock of 1.6 m
MASKS = 16  # of a set are asked, evenly picked
_NO_GROUND_M = -1e6  # a set has no ground that a camera must stay above


class PhotographViewpoints(ViewpointSource):
    """The photographs of a set, taken at ``positions_m`` (N, 3) about the target of the configuration.

    ``ordered`` is the configuration as asked for: elevations are counted about its target. ``key`` and ``replicate`` draw by how
    much the seed layout is turned about the object; replicate 0 begins where the configuration says.
    """

    follows_target = False  # what was photographed, and from where, is known

    def __init__(
        self, positions_m: Floats, target_m: Sequence[float], ordered: MissionConfig, key: str, replicate: int
    ) -> None:
        self.positions_m = np.asarray(positions_m, dtype=float).reshape(-1, 3)
        offset = self.positions_m - np.asarray(target_m)
        self.directions = directions_from(np.asarray(target_m), self.positions_m)
        self.azimuths_deg, self.elevations_deg = azimuths_elevations_deg(offset)
        self.turn_deg = (
            float(keyed_rng("photographs-turn", key, replicate).uniform(0.0, 360.0)) if replicate else 0.0
        )
        pool, centre_m = ordered.pool, ordered.target_m[2]
        self.lowest_deg, self.highest_deg = (
            float(np.rad2deg(np.arcsin(np.clip((altitude_m - centre_m) / pool.radius_m, -1.0, 1.0))))
            for altitude_m in (pool.min_altitude_m, pool.max_altitude_m)
        )
        self.highest_deg = min(self.highest_deg, pool.max_elevation_deg)

    def index(self, viewpoint: Viewpoint) -> int:
        return int(self.nearest(np.array([viewpoint.position_m]))[0])

    def nearest(self, positions_m: Floats) -> Ints:
        """(K,) which photographs were taken at (K, 3)."""
        return cdist(positions_m.reshape(-1, 3), self.positions_m).argmin(axis=1)

    def seeds(self, config: MissionConfig) -> Sequence[Viewpoint]:
        """The nearest photographs to the seed viewpoints turned by ``turn_deg``: the assignment with the least sum of squared angles.

        `MissionFailure` ``not_photographed`` where the set has too few photographs, most viewpoints are on sides without any, none is
        near more than a quarter of the others, or hardly any is within the altitudes of the pool.
        """
        allowed, wanted = int(self.within_altitudes.sum()), seed_viewpoints(config)
        if config.planned_views and allowed < min(config.photographs, len(self.positions_m) / 4):
            lower, upper = np.sort(self.elevations_deg)[
                [len(self.elevations_deg) // 4, 3 * len(self.elevations_deg) // 4]
            ]
            raise MissionFailure(
                "not_photographed",
                f"pool.min_altitude_m {config.pool.min_altitude_m:g} and pool.max_altitude_m {config.pool.max_altitude_m:g} "
                f"are elevations of {self.lowest_deg:.0f} to {self.highest_deg:.0f} degrees about the object, "
                f"where there are {allowed} photographs to choose from: half of all photographs lie between "
                f"{lower:.0f} and {upper:.0f} degrees; widen them",
            )
        if len(wanted) > len(self.positions_m):
            raise MissionFailure(
                "not_photographed",
                f"the configuration has {len(wanted)} seeds, and {len(self.positions_m)} photographs may be taken; "
                "take fewer seeds",
            )
        azimuth_deg, elevation_deg = np.array([(v.azimuth_deg, v.elevation_deg) for v in wanted]).T
        angle_deg = angles_deg(unit_vectors(azimuth_deg - self.turn_deg, elevation_deg), self.directions)
        angle_deg = angle_deg[angle_deg.min(axis=1) <= SEED_CAP_DEG]
        rows, columns = linear_sum_assignment(angle_deg**2)
        near = angle_deg[rows, columns] <= SEED_CAP_DEG
        away_deg = np.abs((azimuth_deg[:, None] - self.turn_deg - self.azimuths_deg + 180) % 360 - 180)
        around = int((away_deg.min(axis=1) <= SEED_CAP_DEG).sum())
        if around < max(3, LEAST_AROUND * len(wanted)):
            between = "; ".join(f"{low:.0f}° and {high:.0f}°" for low, high in gaps_deg(self.azimuths_deg))
            raise MissionFailure(
                "not_photographed",
                f"only {around} of the {len(wanted)} seeds have a photograph within {SEED_CAP_DEG:g} degrees in azimuth: none "
                f"was taken between {between}",
            )
        if near.sum() < max(3, (1.0 - MOST_MISSING) * around):
            raise MissionFailure(
                "not_photographed",
                f"only {near.sum()} of the {len(wanted)} seeds have a photograph within {SEED_CAP_DEG:g} degrees: "
                f"they ask for elevations of {elevation_deg.min():.0f} to {elevation_deg.max():.0f} "
                f"degrees, and the photographs have {self.elevations_deg.min():.0f} to "
                f"{self.elevations_deg.max():.0f}; set seed.lowest_deg and seed.span_deg (or seed.ring_elevations_deg)",
            )
        seeds = []
        for number, column in enumerate(columns[near].tolist()):
            x, y, z = self.positions_m[column].tolist()
            angles = float(self.azimuths_deg[column]), float(self.elevations_deg[column])
            seeds.append(Viewpoint(f"seed_{number:02d}", (x, y, z), *angles, "seed"))
        return seeds

    def candidates(
        self, config: MissionConfig, vehicle_position_m: Floats, visited_m: Floats, n_seeds: int
    ) -> CandidatePool:
        """The photographs not taken yet, between the elevations that ``pool.min_altitude_m`` and ``max_altitude_m`` mean in the paper's pool."""
        left = np.ones(len(self.positions_m), dtype=bool)
        counts = {"raw": len(left)}
        if len(visited_m):
            left[self.nearest(visited_m)] = False
        counts["revisit"] = int(left.sum())
        keep = np.flatnonzero(left & self.within_altitudes)
        counts["altitude_travel"] = len(keep)
        positions = self.positions_m[keep]
        return CandidatePool(
            ids=tuple(f"cand_{i:03d}" for i in keep.tolist()),
            positions_m=positions,
            headings_rad=heading_to(positions, np.array(config.target_m)),
            azimuths_deg=self.azimuths_deg[keep],
            elevations_deg=self.elevations_deg[keep],
            bands=tuple(np.where(self.elevations_deg[keep] > UPPER_BAND_DEG, "upper", "lateral").tolist()),
            counts=counts,
        )

    @property
    def within_altitudes(self) -> Bools:
        """(N,) which photographs the altitude limits of the pool allow."""
        return (self.elevations_deg >= self.lowest_deg) & (self.elevations_deg <= self.highest_deg)


class PhotographCamera(Camera):
    """Returns the set's photograph at each of its ``viewpoints``, and the reference's pose with the errors of ``telemetry``."""

    def __init__(
        self, context: MissionContext, photographs: PhotographSet, viewpoints: PhotographViewpoints
    ) -> None:
        super().__init__(photographs.target_m)
        self._set, self._viewpoints = photographs, viewpoints
        telemetry, key = context.config.telemetry, context.rock.sha256
        self._errors = TelemetryErrors(telemetry, key, context.replicate, _NO_GROUND_M)
        self.taken: list[str] = []  # names, in order

    def take_photograph(self, viewpoint: Viewpoint, position_m: Floats, time_s: float) -> Capture:
        photograph = self._set.registered[self._viewpoints.index(viewpoint)]
        assert photograph.camera_from_world is not None
        reported = self._errors.true_pose(photograph.camera_from_world, viewpoint.id, time_s)
        self.taken.append(photograph.name)
        return Capture(f"{viewpoint.id}.png", viewpoint, reported, self._set.image(photograph.name))


def measure_cloud(cloud: Cloud, photographs: PhotographSet, config: EvaluationConfig) -> Evaluation:
    """Of a mission's cloud in the set's frame; both surfaces, ``whole`` and ``observable``, are the dense reference.

    `MissionFailure` where nothing is left after cleaning.
    """
    reference_m = photographs.reference().points_m
    truth_m = _picked(reference_m, config.gt_samples, photographs.name)
    low, high = reference_m.min(axis=0), reference_m.max(axis=0)
    margin_m = MARGIN * photographs.height_m
    half_m = float(np.abs([low - photographs.target_m, high - photographs.target_m]).max()) + margin_m
    no_ground = dataclasses.replace(config, crop_half_extent_m=half_m, ground_ransac_iterations=0)
    cleaned, report = clean_cloud(cloud, no_ground, photographs.target_m)
    low, high = low - [margin_m, margin_m, 0.0], high + margin_m
    reaches_m = tuple(reach * photographs.height_m for reach in REACHES)
    registration = register_cloud(_within(cleaned, low, high).points_m, truth_m, reaches_m)
    cleaned = _within(moved(cleaned, registration), low, high)
    cleaned = select(cleaned, in_masks(cleaned.points_m, photographs))
    if len(cleaned) == 0:
        raise MissionFailure("empty_cloud", "no dense point lies near the reference")
    scale = DEFAULT_HEIGHT_M / photographs.height_m
    to_reference_m, _ = nearest_neighbours(reference_m, cleaned.points_m)
    truth = GroundTruthSamples(scale * truth_m, np.ones(len(truth_m), dtype=bool))
    scaled = PointCloud(scale * cleaned.points_m, cleaned.colors, cleaned.normals)
    metrics = compute_metrics(scaled, truth, config, (0.0, 0.0, DEFAULT_HEIGHT_M / 2), scale * to_reference_m)
    metrics["reference"] = {
        "registration": {"scale": registration.scale, "turn_deg": registration.turn_deg},
        "ceiling": ceiling(photographs),
    }
    metrics["cleaning"] = report
    return Evaluation(metrics, report, cleaned)


def ceiling(photographs: PhotographSet) -> dict[str, float]:
    """One half of the photographs against the other, by the names of the metrics: the reference cannot tell better scores apart."""
    halves = photographs.halves
    scores = {}
    for k, fraction in enumerate(THRESHOLD_FRACTIONS):
        name = f"{1000 * fraction * DEFAULT_HEIGHT_M:.0f}mm"
        scores[f"f_score_{name}"] = halves.f_score[k]
        scores[f"completeness_{name}"] = halves.completeness[k]
        scores[f"accuracy_{name}"] = halves.precision[k]
    return scores


def _within(cloud: Cloud, low_m: Floats, high_m: Floats) -> PointCloud:
    inside = (cloud.points_m >= low_m) & (cloud.points_m <= high_m)
    return select(cloud, np.all(inside, axis=1))


def in_masks(points_m: Floats, photographs: PhotographSet) -> Bools:
    """(N,) which points (N, 3) lie on the object in half of the masks that show them; all where the set has none."""
    masked = [p for p in photographs.registered if p.masked]
    outside, shown = np.zeros(len(points_m)), np.zeros(len(points_m))
    camera = photographs.camera
    for photograph in masked[:: max(1, len(masked) // MASKS)]:
        mask, pose = photographs.mask(photograph.name), photograph.camera_from_world
        assert mask is not None and pose is not None
        seen_m = points_m @ pose[:3, :3].T + pose[:3, 3]
        at_px = camera.focal_px * seen_m[:, :2] / seen_m[:, 2:] + [camera.width_px / 2, camera.height_px / 2]
        there = (seen_m[:, 2] > 0) & (at_px >= 0).all(axis=1) & (at_px < mask.shape[::-1]).all(axis=1)
        column, row = at_px[there].astype(int).T
        shown += there
        outside[there] += ~mask[row, column]
    inside: Bools = outside <= (1.0 - IN_MASK) * shown
    return inside


def _picked(points_m: Floats, count: int, key: str) -> Floats:
    """At most ``count`` of the points, drawn."""
    if len(points_m) <= count:
        return points_m
    chosen = keyed_rng("reference-samples", key).choice(len(points_m), count, replace=False)
    return points_m[np.sort(chosen)]


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
    return dataclasses.replace(config, camera=photographs.camera, target_m=photographs.target_m)


# Run one mission over the photographs of the set ``rock`` and measure its cloud: a `nbv.mission.MissionFunction`.
run_photographs_mission = PhotographFidelity.run
