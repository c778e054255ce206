"""Features and pairs as COLMAP's mapper takes them: in memory, without a database file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import pycolmap

from nbv.sparse.matching import VerifiedPair
from nbv.types import Floats


def database_cache(
    names: Sequence[str],
    keypoints_px: Sequence[Floats],
    cameras: Mapping[int, pycolmap.Camera],
    camera_ids: Sequence[int],
    pairs: Mapping[tuple[int, int], VerifiedPair],
) -> pycolmap.DatabaseCache:
    """Images and pairs as COLMAP's in-memory cache, with one frame an image and one rig a camera, as COLMAP wants.

    Parameters
    ----------
    names
        Of the images; their ids count from 1 in this order.
    keypoints_px
        (K, 2) of each image.
    cameras
        By id.
    camera_ids
        Of each image.
    pairs
        By image ids, the smaller first.
    """
    cache = pycolmap.DatabaseCache()
    for camera_id, camera in cameras.items():
        cache.add_camera(camera)
        rig = pycolmap.Rig()
        rig.rig_id = camera_id
        rig.add_ref_sensor(camera.sensor_id)
        cache.add_rig(rig)
    graph = cache.correspondence_graph
    for image_id, (name, keypoints, camera_id) in enumerate(
        zip(names, keypoints_px, camera_ids, strict=True), start=1
    ):
        image = pycolmap.Image(name=name, keypoints=keypoints, camera_id=camera_id, image_id=image_id)
        image.frame_id = image_id
        frame = pycolmap.Frame()
        frame.frame_id = image_id
        frame.rig_id = camera_id
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
