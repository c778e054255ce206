"""Frames, cameras, rays, samples and neighbours: geometry that every stage shares."""
