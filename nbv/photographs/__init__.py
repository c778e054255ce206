"""Real photographs of one object, imported once: poses, a dense reference with its own error, a surface."""

from nbv.photographs.photograph_set import (
    HalvesAgreement,
    Photograph,
    PhotographSet,
    Reference,
    list_sets,
)

__all__ = [
    "HalvesAgreement",
    "Photograph",
    "PhotographSet",
    "Reference",
    "list_sets",
]
