"""Ax, SMAC3 and HEBO, each in an environment of its own, beside our sampler."""
