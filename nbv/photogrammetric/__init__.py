"""Missions with photographs: renderer, COLMAP, stereo, and the store in front of them."""

from nbv.photogrammetric.mission import run_photogrammetric_mission
from nbv.photogrammetric.reconstructor import PhotogrammetricReconstructor

__all__ = ["PhotogrammetricReconstructor", "run_photogrammetric_mission"]
