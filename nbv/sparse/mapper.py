"""COLMAP's incremental mapper (Schönberger and Frahm, "Structure-from-Motion Revisited", CVPR 2016), step by step in this process.

Between updates the whole state is the reconstruction, the keypoints and the verified pairs; COLMAP's mapper
object (with its hidden counters) lives only inside one update.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager

import numpy as np
import pycolmap
from numpy.typing import NDArray

from nbv.config import MissionConfig, SparseConfig
from nbv.errors import MissionFailure
from nbv.process import Stopwatch
from nbv.sparse.colmap import CAMERA_ID, colmap_camera, files_of, model_of, pipeline_options
from nbv.sparse.features import VerifiedPair

_SEED = 0
_MAX_INITIAL_PAIRS = 3  # seed models tried before giving up
_BOOTSTRAP_GROWTH = 1.25  # global adjustment each time the seed model has grown by this factor
_GLOBAL_REFINEMENTS = 3
_LOCAL_CHANGE = 1e-3  # a refinement stops once fewer observations than this fraction change
_GLOBAL_CHANGE = 5e-4
# Half of COLMAP's 30 and 0.25, which guard against wrong poses where nothing else does.
_GUARDED_POSE_INLIERS, _GUARDED_POSE_INLIER_RATIO = 15, 0.15
# For seeds that are left over after that, each pose compared with telemetry before it is kept.
_JUDGED_POSE_INLIERS, _JUDGED_POSE_INLIER_RATIO, _JUDGED_POSE_TRIALS = 6, 0.05, 10
_ENOUGH_SEEDS = 0.75  # share of them; points that came with the rest once hid a target

Judge = Callable[[pycolmap.Reconstruction, int], str]
"""Given the model and the image just registered: "" to keep it, otherwise why its pose is wrong."""


def mapping_options(config: SparseConfig) -> pycolmap.IncrementalPipelineOptions:
    """COLMAP's options for one thread, a fixed seed and known intrinsics."""
    options = pipeline_options(1)
    options.ba_refine_focal_length = False
    options.ba_refine_principal_point = False
    options.ba_refine_extra_params = False
    options.ba_refine_sensor_from_rig = False
    options.constant_cameras = {CAMERA_ID}
    options.mapper.constant_cameras = {CAMERA_ID}
    options.mapper.abs_pose_refine_focal_length = False
    options.mapper.abs_pose_refine_extra_params = False
    options.mapper.ba_local_num_images = config.local_ba_images
    options.min_num_matches = config.min_inliers
    return options


class IncrementalModel:
    """A growing COLMAP model of one mission. Image ids count from 1 in the order of `add_image`.

    Where telemetry errs somebody compares poses with it, so that fewer matches may register a photograph.
    """

    def __init__(self, config: MissionConfig, stopwatch: Stopwatch) -> None:
        self.camera, self.config = config.camera, config.sparse
        self.names: list[str] = []
        self.keypoints_px: list[NDArray[np.float64]] = []  # (K, 2) per image
        self.pairs: dict[tuple[int, int], VerifiedPair] = {}  # (smaller id, larger id)
        self.reconstruction = pycolmap.Reconstruction()
        self.captures_since_global = 0
        self.stopwatch = stopwatch
        self._usual = mapping_options(self.config)
        if not config.telemetry.is_exact:  # else COLMAP's own thresholds stand
            self._usual.mapper.abs_pose_min_num_inliers = _GUARDED_POSE_INLIERS
            self._usual.mapper.abs_pose_min_inlier_ratio = _GUARDED_POSE_INLIER_RATIO
        self._local_ba = self._usual.get_local_bundle_adjustment()
        self.global_ba = self._usual.get_global_bundle_adjustment()
        for ba in (self._local_ba, self.global_ba):
            ba.ceres.solver_options.num_threads = 1

    def add_image(self, name: str, keypoints_px: NDArray[np.floating]) -> int:
        """Add a photograph's keypoints (K, 2); returns its image id."""
        if name in self.names:
            raise ValueError(f"image {name!r} is already in the model")
        self.names.append(name)
        self.keypoints_px.append(np.array(keypoints_px[:, :2], dtype=np.float64))
        return len(self.names)

    def add_pairs(self, pairs: Mapping[tuple[int, int], VerifiedPair]) -> None:
        """Add verified pairs ``{(id_a, id_b): pair}`` with ``id_a < id_b``."""
        self.pairs |= {ids: pair for ids, pair in pairs.items() if len(pair) >= self.config.min_inliers}

    def bootstrap(
        self, require_good: Callable[[pycolmap.Reconstruction], object], judge_pose: Judge | None
    ) -> None:
        """Build the seed model from all images so far.

        Up to three initial pairs are tried until ``require_good`` does not raise `MissionFailure` at the model; the last failure
        is raised, or ``seed_model_failed`` where no pair is fit to start from. ``judge_pose`` is for `_join`.
        """
        pycolmap.set_random_seed(_SEED)
        with self.stopwatch.timed("sparse.mapping"):
            mapper = pycolmap.IncrementalMapper(self._database_cache(self.pairs))
        failure = MissionFailure("seed_model_failed", "no pair of seed images is fit to start from")
        for _ in range(_MAX_INITIAL_PAIRS):
            reconstruction = pycolmap.Reconstruction()
            mapper.begin_reconstruction(reconstruction)
            if not self._initialise(mapper):
                mapper.end_reconstruction(True)
                break
            self._grow(mapper, self._usual)
            if judge_pose and reconstruction.num_reg_images() < _ENOUGH_SEEDS * len(self.names):
                self._join(mapper, judge_pose)
            try:
                require_good(reconstruction)
            except MissionFailure as error:
                failure = error
                mapper.end_reconstruction(True)  # frees the rejected model's images for the next initial pair
                continue
            mapper.end_reconstruction(False)
            self.reconstruction = reconstruction
            self.put_in_order()
            return
        raise failure

    def put_in_order(self) -> None:
        """Give COLMAP's hash tables the order of a model read from disk: theirs depends on their history, down to the last bits of adjustments."""
        self.reconstruction = model_of(files_of(self.reconstruction))

    def _initialise(self, mapper: pycolmap.IncrementalMapper) -> bool:
        """Start from the best pair; thresholds are relaxed as COLMAP's controller does."""
        invalid = -1
        options = self._usual.get_mapper()
        with self.stopwatch.timed("sparse.mapping"):
            initial_pair = None
            for inlier_factor, angle_factor in ((1.0, 1.0), (0.5, 1.0), (0.5, 0.5)):
                relaxed = self._usual.get_mapper()
                relaxed.init_min_num_inliers = int(options.init_min_num_inliers * inlier_factor)
                relaxed.init_min_tri_angle = options.init_min_tri_angle * angle_factor
                initial_pair = mapper.find_initial_image_pair(relaxed, invalid, invalid)
                if initial_pair is not None:
                    break
                mapper.reset_initialization_stats()
            if initial_pair is None:
                return False
            (first, second), second_from_first = initial_pair
            mapper.register_initial_image_pair(options, first, second, second_from_first)
            for image_id in (first, second):
                mapper.triangulate_image(self._usual.get_triangulation(), image_id)
        with self.stopwatch.timed("sparse.ba"):
            mapper.adjust_global_bundle(options, self.global_ba)
            mapper.reconstruction.normalize()
            mapper.filter_points(options)
        return mapper.reconstruction.num_points3D() > 0

    def _grow(
        self,
        mapper: pycolmap.IncrementalMapper,
        options: pycolmap.IncrementalPipelineOptions,
        judge: Judge | None = None,
    ) -> None:
        """Register whatever can be registered, with global adjustments as the model grows."""
        model = mapper.reconstruction
        last_images = model.num_reg_images()
        while True:
            with self.stopwatch.timed("sparse.mapping"):
                candidates = mapper.find_next_images(options.get_mapper(), False)
            if all(self._register(mapper, image_id, options, judge) for image_id in candidates):
                break
            if model.num_reg_images() >= _BOOTSTRAP_GROWTH * last_images:
                self._refine_globally(mapper, options)
                last_images = model.num_reg_images()
        self._refine_globally(mapper, options)

    def _join(self, mapper: pycolmap.IncrementalMapper, judge: Judge) -> None:
        """Grow on by poses from few points: where views are far apart hardly any point is seen by three images."""
        options, model = self._for_judged_poses(), mapper.reconstruction
        options.triangulation.ignore_two_view_tracks = False
        held, before = set(model.reg_image_ids()), set(model.point3D_ids())
        with self.stopwatch.timed("sparse.mapping"):
            for image_id in sorted(held):
                mapper.triangulate_image(options.get_triangulation(), image_id)
        self._grow(mapper, options, judge)
        # Points of two images hold those that joined; the others did without.
        with self.stopwatch.timed("sparse.mapping"):
            for point_id in sorted(set(model.point3D_ids()) - before):
                seen_by = {element.image_id for element in model.point3D(point_id).track.elements}
                if len(seen_by) == 2 and seen_by <= held:
                    mapper.observation_manager.delete_point3D(point_id)
        self._refine_globally(mapper, self._usual)

    def _for_judged_poses(self) -> pycolmap.IncrementalPipelineOptions:
        options = mapping_options(self.config)
        options.mapper.abs_pose_min_num_inliers = _JUDGED_POSE_INLIERS
        options.mapper.abs_pose_min_inlier_ratio = _JUDGED_POSE_INLIER_RATIO
        options.mapper.max_reg_trials = _JUDGED_POSE_TRIALS
        return options

    def update(self, new_id: int, judge: Judge, judge_turn: Judge | None) -> dict[int, str]:
        """Register image ``new_id`` and retry every earlier unregistered image: why each was left out, ``{image_id: reason}``.

        With ``judge_turn`` what is left out is tried again, from few matches; both judges must keep it.
        """
        registered = set(self.reconstruction.reg_image_ids())
        waiting = [new_id] + [i for i in range(1, len(self.names) + 1) if i not in registered | {new_id}]
        is_global = self.captures_since_global + 1 >= self.config.global_ba_interval
        pairs = (
            self.pairs if is_global or self.config.update_pairs == "all" else pairs_near(self.pairs, waiting)
        )
        with self._mapper_of_model(pairs) as mapper:
            reasons = self._try_all(mapper, waiting, self._usual, judge)
            if reasons and judge_turn:
                left = [image_id for image_id in waiting if image_id in reasons]
                reasons = self._try_all(
                    mapper,
                    left,
                    self._for_judged_poses(),
                    lambda model, i: judge(model, i) or judge_turn(model, i),
                )
            self.captures_since_global += 1
            if is_global:
                self._refine_globally(mapper, self._usual)
                self.captures_since_global = 0
        return reasons

    def refine(self) -> None:
        """Global adjustment of the model as it stands, e.g. before the dense stage."""
        with self._mapper_of_model(self.pairs) as mapper:
            self._refine_globally(mapper, self._usual)
        self.captures_since_global = 0

    @contextmanager
    def _mapper_of_model(
        self, pairs: Mapping[tuple[int, int], VerifiedPair]
    ) -> Iterator[pycolmap.IncrementalMapper]:
        """COLMAP's mapper on the model as it stands, whose adjustments begin close to where they end."""
        pycolmap.set_random_seed(_SEED)
        for ba, limit in (
            (self._local_ba, self.config.local_ba_iterations),
            (self.global_ba, self.config.global_ba_iterations),
        ):
            if limit:
                ba.ceres.solver_options.max_num_iterations = limit
        with self.stopwatch.timed("sparse.mapping"):
            mapper = pycolmap.IncrementalMapper(self._database_cache(pairs))
            mapper.begin_reconstruction(self.reconstruction)
        yield mapper
        with self.stopwatch.timed("sparse.mapping"):
            mapper.end_reconstruction(False)

    def _try_all(
        self,
        mapper: pycolmap.IncrementalMapper,
        image_ids: Sequence[int],
        options: pycolmap.IncrementalPipelineOptions,
        judge: Judge,
    ) -> dict[int, str]:
        """Until no more registers: a new registration can make an earlier image registrable. Returns what was left out."""
        waiting, reasons, progress = list(image_ids), dict[int, str](), True
        needed = options.mapper.abs_pose_min_num_inliers
        while waiting and progress:
            progress = False
            for image_id in list(waiting):
                visible = mapper.observation_manager.num_visible_points3D(image_id)
                if visible < needed:
                    reason = f"sees {visible} points of the model, registration needs {needed}"
                else:
                    reason = self._register(mapper, image_id, options, judge)
                    if not reason and not mapper.reconstruction.image(image_id).has_pose:
                        reason = "lost its points in the adjustment"
                reasons[image_id] = reason
                if not reason:
                    waiting.remove(image_id)
                    progress = True
        return {image_id: reasons[image_id] for image_id in waiting}

    def _register(
        self,
        mapper: pycolmap.IncrementalMapper,
        image_id: int,
        options: pycolmap.IncrementalPipelineOptions,
        judge: Judge | None,
    ) -> str:
        """Register one image and adjust locally about it; why it was left out, or "" where it is registered."""
        with self.stopwatch.timed("sparse.mapping"):
            visible = mapper.observation_manager.num_visible_points3D(image_id)
            if not mapper.register_next_image(options.get_mapper(), image_id):
                return f"no consistent pose from {visible} visible points"
            if judge is not None and (reason := judge(mapper.reconstruction, image_id)):
                mapper.observation_manager.deregister_frame(image_id)
                return reason
            mapper.triangulate_image(options.get_triangulation(), image_id)
        with self.stopwatch.timed("sparse.ba"):
            mapper.iterative_local_refinement(
                self.config.local_ba_rounds,
                _LOCAL_CHANGE,
                options.get_mapper(),
                self._local_ba,
                options.get_triangulation(),
                image_id,
            )
        return ""

    def _refine_globally(
        self, mapper: pycolmap.IncrementalMapper, options: pycolmap.IncrementalPipelineOptions
    ) -> None:
        with self.stopwatch.timed("sparse.ba"):
            mapper.iterative_global_refinement(
                _GLOBAL_REFINEMENTS,
                _GLOBAL_CHANGE,
                options.get_mapper(),
                self.global_ba,
                options.get_triangulation(),
                True,
            )

    def _database_cache(self, pairs: Mapping[tuple[int, int], VerifiedPair]) -> pycolmap.DatabaseCache:
        """All images and some pairs as COLMAP's in-memory cache, with one frame an image and one rig, as COLMAP wants."""
        camera = colmap_camera(self.camera)
        rig = pycolmap.Rig(rig_id=CAMERA_ID)
        rig.add_ref_sensor(camera.sensor_id)
        cache = pycolmap.DatabaseCache()
        cache.add_camera(camera)
        cache.add_rig(rig)
        graph = cache.correspondence_graph
        for image_id, (name, keypoints) in enumerate(
            zip(self.names, self.keypoints_px, strict=True), start=1
        ):
            image = pycolmap.Image(name=name, keypoints=keypoints, camera_id=CAMERA_ID, image_id=image_id)
            image.frame_id = image_id
            frame = pycolmap.Frame(frame_id=image_id, rig_id=CAMERA_ID)
            frame.add_data_id(image.data_id)
            frame.finalize_data_ids()
            cache.add_frame(frame)
            cache.add_image(image)
            if not graph.exists_image(image_id):
                graph.add_image(image_id, len(keypoints))
        for (a, b), pair in sorted(pairs.items()):
            geometry = pycolmap.TwoViewGeometry()
            geometry.config = pair.config
            geometry.inlier_matches = pair.matches
            graph.add_two_view_geometry(a, b, geometry)
        graph.finalize()
        return cache


def pairs_near(
    pairs: Mapping[tuple[int, int], VerifiedPair], image_ids: Sequence[int]
) -> dict[tuple[int, int], VerifiedPair]:
    """Of ``pairs``, those of these images and of the images that they were matched with, whose tracks may grow and merge.

    Every image keeps one pair at least, since COLMAP's graph drops images that have none.
    """
    images = set(image_ids)
    near = images | {i for ids in pairs if not images.isdisjoint(ids) for i in ids}
    chosen = {ids: pair for ids, pair in pairs.items() if not near.isdisjoint(ids)}
    held = {i for ids in chosen for i in ids}
    for ids, pair in pairs.items():
        if not held.issuperset(ids):
            chosen[ids] = pair
            held.update(ids)
    return chosen
