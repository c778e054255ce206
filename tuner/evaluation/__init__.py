"""Configurations against baselines on common rocks, with paired statistics."""
