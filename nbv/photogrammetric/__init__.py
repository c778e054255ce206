"""Missions with photographs: renderer, COLMAP, stereo."""
