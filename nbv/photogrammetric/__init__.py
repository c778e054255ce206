"""Missions with photographs: renderer, COLMAP, stereo, and the store in front of them."""

from nbv.photogrammetric.photogrammetric_fidelity import run_photogrammetric_mission

__all__ = ["run_photogrammetric_mission"]
