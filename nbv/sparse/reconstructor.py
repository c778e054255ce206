"""The sparse half of a photogrammetric reconstruction: photographs in, aligned sparse models out."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import pycolmap

from nbv.config import MissionConfig
from nbv.errors import MissionFailure, UserError
from nbv.geometry.frames import angle_deg, camera_centers_m
from nbv.sparse.alignment import Alignment, align_cameras, outlier_limit_m, turns_deg
from nbv.sparse.colmap import (
    camera_from_model_poses,
    camera_from_world_poses,
    registered_names,
    to_sparse_model,
)
from nbv.sparse.features import Correspondences, Features
from nbv.sparse.mapper import IncrementalModel
from nbv.types import Capture, Floats, UpdateReport

TELEMETRY_SDS = 2.0  # of 24 cameras the rms error stays below 1.3 standard deviations in 99.9 % of flights
ATTITUDE_SDS = 5.0  # per axis; of a turn about a random axis 1 in 20,000 is larger
FEWEST_CAMERAS = 6  # below, the model is too small to be held by positions that err


class SparseReconstructor:
    """Features, matching, incremental mapping and alignment of one mission, in one thread.

    Telemetry chooses which pairs to match, aligns the model and lets a wrong one be noticed; where it errs it also is the
    adjustment's prior. A model that disagrees by no more than twice the distance that its specification promises is not wrong.
    """

    alignment: Alignment  # since `bootstrap`: of the registered images, by ascending image id

    def __init__(self, config: MissionConfig, correspondences: Correspondences | None = None) -> None:
        self.camera, self.config, self.telemetry = config.camera, config.sparse, config.telemetry
        self.tolerance_m = math.hypot(
            self.config.max_alignment_rms_m, TELEMETRY_SDS * self.telemetry.position_sd_m
        )
        self.target_m = np.array(config.target_m)
        self._source = correspondences or Correspondences(config)
        self._stopwatch = self._source.stopwatch
        self._model = IncrementalModel(config, self._stopwatch)
        self._captures: list[Capture] = []
        self._features: list[Features] = []

    @property
    def reconstruction(self) -> pycolmap.Reconstruction:
        """COLMAP's model in its own frame and scale; see :attr:`alignment`."""
        return self._model.reconstruction

    def world_camera_poses(self) -> dict[str, Floats]:
        """(4, 4) ``camera_from_world`` in metres of every registered image, from SfM and alignment."""
        poses = camera_from_world_poses(
            camera_from_model_poses(self.reconstruction), self.alignment.world_from_model
        )
        return dict(zip(registered_names(self.reconstruction), poses))

    def world_points_m(self) -> Floats:
        """(N, 3) the model's points in metres."""
        return to_sparse_model(self.reconstruction, self.alignment).points_m

    def bootstrap(self, captures: Sequence[Capture]) -> UpdateReport:
        """Build the seed model.

        `MissionFailure` ``seed_model_failed`` when too few seeds register, ``wrong_model`` when the model that COLMAP finds
        disagrees with telemetry.
        """
        self._take_in(captures)

        def require_good(reconstruction: pycolmap.Reconstruction) -> None:
            count = reconstruction.num_reg_images()
            if count < self.config.min_registered_seeds:
                raise MissionFailure(
                    "seed_model_failed",
                    f"only {count} of {len(captures)} seed images registered "
                    f"(sparse.min_registered_seeds is {self.config.min_registered_seeds})",
                )
            self._align(reconstruction)

        self._model.bootstrap(require_good, None if self.telemetry.is_exact else self._judge_attitude)
        self._hold_by_telemetry()
        dropped = self._drop_outliers()
        registered = set(registered_names(self.reconstruction))
        absent = [c.name for c in self._captures if c.name not in registered]
        if len(registered) < self.config.min_registered_seeds:
            raise MissionFailure("wrong_model", f"{len(registered)} seeds agree with telemetry: {dropped}")
        notes = [dropped] if dropped else []
        if absent:
            notes.append(f"not registered: {', '.join(absent)}")
        self._model.put_in_order()
        return self._report(True, "; ".join(notes))

    def add(self, capture: Capture) -> UpdateReport:
        """Extend the model by one capture, and retry the earlier images that are still out.

        `MissionFailure` ``wrong_model`` when the model as a whole no longer agrees with telemetry.
        """
        before = set(registered_names(self.reconstruction))
        self._take_in([capture])
        new_id = len(self._captures)
        judge_turn = None if self.telemetry.is_exact else self._judge_attitude
        reasons = self._model.update(new_id, self._judge_pose, judge_turn)
        if self._model.captures_since_global == 0:
            self._hold_by_telemetry()
        dropped = self._drop_outliers()
        registered = set(registered_names(self.reconstruction))
        notes = []
        if capture.name not in registered:
            notes.append(f"{capture.name}: {reasons.get(new_id) or dropped or 'not registered'}")
        elif dropped:
            notes.append(dropped)
        late = sorted(registered - before - {capture.name})
        if late:
            notes.append(f"now registered too: {', '.join(late)}")
        if waiting := len(self._captures) - len(registered):
            notes.append(f"{waiting} not registered so far, all tried again after the next photograph")
        return self._report(capture.name in registered, "; ".join(notes))

    def refine(self) -> None:
        """Global adjustment, to be called once before the dense stage."""
        if self._model.captures_since_global:
            self._model.refine()
            self._hold_by_telemetry()
        self._drop_outliers()

    def _take_in(self, captures: Sequence[Capture]) -> None:
        """Features of each capture and its verified pairs with all earlier ones."""
        for capture in captures:
            shape = (self.camera.height_px, self.camera.width_px, 3)
            if capture.image is None or capture.image.shape != shape:
                got = "no image" if capture.image is None else f"an image of shape {capture.image.shape}"
                raise UserError(f"capture {capture.name} has {got}; the camera needs {shape}")
            features = self._source.features(capture.image)
            if self.config.ground_features:
                seen = self._source.ground_features(capture.image, capture.camera_from_world)
                features = features.with_ground(seen)
            new_id = self._model.add_image(capture.name, features.keypoints)
            pairs = {
                (old_id, new_id): self._source.pair(self._features[old_id - 1], features)
                for old_id in self._partners(capture)
            }
            self._model.add_pairs(pairs)
            self._captures.append(capture)
            self._features.append(features)

    def _partners(self, capture: Capture) -> list[int]:
        """Ids of the earlier captures to match with: nearest viewing directions first, ties by age."""
        sight = camera_centers_m(capture.camera_from_world) - self.target_m
        angles_deg = [
            angle_deg(camera_centers_m(old.camera_from_world) - self.target_m, sight)
            for old in self._captures
        ]
        near = [i for i, angle in enumerate(angles_deg) if angle <= self.config.max_pair_angle_deg]
        near.sort(key=lambda i: round(angles_deg[i], 6))  # equal angles are equal beyond rounding
        if self.config.max_pairs:
            near = near[: self.config.max_pairs]
        return [i + 1 for i in near]

    def _telemetry(self, reconstruction: pycolmap.Reconstruction) -> Floats:
        ids = sorted(reconstruction.reg_image_ids())
        return np.array([self._captures[i - 1].camera_from_world for i in ids]).reshape(-1, 4, 4)

    def _align(self, reconstruction: pycolmap.Reconstruction) -> None:
        with self._stopwatch.timed("sparse.alignment"):
            self.alignment = align_cameras(
                camera_from_model_poses(reconstruction),
                self._telemetry(reconstruction),
                self.tolerance_m,
                self.telemetry,
            )

    def _hold_by_telemetry(self) -> None:
        """After a global adjustment, one more in which telemetry that errs is a prior; it puts the model into the world frame.

        COLMAP's pose-prior bundle adjustment: residuals of pixels, with a standard deviation of one pixel, and of camera centres,
        whitened by telemetry's covariance.
        """
        reconstruction = self.reconstruction
        ids = sorted(int(i) for i in reconstruction.reg_image_ids())
        if self.telemetry.is_exact or len(ids) < FEWEST_CAMERAS:
            return
        config, priors = pycolmap.BundleAdjustmentConfig(), []
        for image_id in ids:
            config.add_image(image_id)
            prior = pycolmap.PosePrior()
            prior.pose_prior_id = image_id
            prior.corr_data_id = reconstruction.image(image_id).data_id
            prior.position = camera_centers_m(self._captures[image_id - 1].camera_from_world)
            prior.position_covariance = np.diag(self.telemetry.covariance_m2)
            prior.coordinate_system = pycolmap.PosePriorCoordinateSystem.CARTESIAN
            priors.append(prior)
        for camera_id in reconstruction.cameras:
            config.set_constant_cam_intrinsics(camera_id)
        options = pycolmap.PosePriorBundleAdjustmentOptions()
        options.alignment_ransac.random_seed = 0
        with self._stopwatch.timed("sparse.priors"):
            pycolmap.create_pose_prior_bundle_adjuster(
                self._model.global_ba, options, config, priors, reconstruction
            ).solve()

    def _judge_pose(self, reconstruction: pycolmap.Reconstruction, image_id: int) -> str:
        """Whether a pose just found agrees with telemetry as the other cameras do."""
        pose = reconstruction.image(image_id).cam_from_world().matrix()[None]
        center = self.alignment.world_from_model.apply(camera_centers_m(pose))[0]
        reported = camera_centers_m(self._captures[image_id - 1].camera_from_world)
        residual_m = float(np.linalg.norm(center - reported))
        limit_m = outlier_limit_m(self.alignment.rms_m, self.tolerance_m)
        if residual_m <= limit_m:
            return ""
        return f"its pose is {residual_m:.2f} m from telemetry (limit {limit_m:.2f} m)"

    def _judge_attitude(self, reconstruction: pycolmap.Reconstruction, image_id: int) -> str:
        """As `_judge_pose` of attitudes, which need no scale: the model may still be too small to align."""
        ids = sorted(int(i) for i in reconstruction.reg_image_ids())
        turned_deg = turns_deg(camera_from_model_poses(reconstruction), self._telemetry(reconstruction))
        limit_deg = ATTITUDE_SDS * max(self.telemetry.attitude_noise_deg, 1.0)
        turn_deg = turned_deg[ids.index(image_id)]
        return "" if turn_deg <= limit_deg else f"it is turned by {turn_deg:.0f}°"

    def _drop_outliers(self) -> str:
        """Align; take cameras that disagree with the rest out of the model. Says which, or ""."""
        self._align(self.reconstruction)
        alignment = self.alignment
        if len(alignment.outliers) == 0:
            return ""
        ids = sorted(self.reconstruction.reg_image_ids())
        names = [
            f"{self._captures[ids[row] - 1].name} ({alignment.residuals_m[row]:.2f} m)"
            for row in alignment.outliers
        ]
        for row in alignment.outliers:
            self.reconstruction.deregister_frame(ids[row])
        self._align(self.reconstruction)
        return f"taken out, pose disagrees with telemetry: {', '.join(names)}"

    def _report(self, registered: bool, message: str) -> UpdateReport:
        with self._stopwatch.timed("sparse.model"):
            model = to_sparse_model(self.reconstruction, self.alignment)
        return UpdateReport(model, registered, message)
