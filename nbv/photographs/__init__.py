"""Real photographs of one object, imported once: poses, a dense reference with its own error, a surface."""

from nbv.photographs.photograph_set import PhotographSet, list_sets

__all__ = ["PhotographSet", "list_sets"]
