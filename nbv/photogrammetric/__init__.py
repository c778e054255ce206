"""Missions with photographs: renderer, COLMAP, stereo, and the store in front of them."""

from nbv.photogrammetric.photogrammetric_fidelity import run_photogrammetric_mission
from nbv.photogrammetric.reconstructor import PhotogrammetricReconstructor

__all__ = ["PhotogrammetricReconstructor", "run_photogrammetric_mission"]
