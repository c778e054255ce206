"""Frames, cameras, rays, samples and neighbours: geometry that every stage shares."""

from nbv.geometry.frames import (
    Similarity,
    align_umeyama,
    heading_to,
    intrinsic_matrix,
    invert_rigid,
    look_at,
    wrap_angle,
)

__all__ = [
    "Similarity",
    "align_umeyama",
    "heading_to",
    "intrinsic_matrix",
    "invert_rigid",
    "look_at",
    "wrap_angle",
]
