"""Real photographs of one object, imported once: poses, a dense reference with its own error, a surface."""

from nbv.photographs.photograph_set import (
    Coverage,
    HalvesAgreement,
    Photograph,
    PhotographSet,
    Reference,
    list_sets,
)

__all__ = [
    "Coverage",
    "HalvesAgreement",
    "Photograph",
    "PhotographSet",
    "Reference",
    "list_sets",
]
