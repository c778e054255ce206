"""A small set of photographs on disk: noise for pictures, a sphere for a reference."""

import numpy as np
from PIL import Image

from nbv.config import CameraConfig
from nbv.geometry.frames import look_at
from nbv.photographs import HalvesAgreement, Photograph, PhotographSet, Reference
from nbv.photographs.photograph_set import IMAGES, REFERENCE_FILE, set_folder

CENTER_M = np.array([0.0, 0.0, 1.3])


def write_set(name: str = "mine", registered: int = 6) -> PhotographSet:
    """Of ``registered`` photographs over 200° and one without a pose; into the home folder of the test."""
    folder = set_folder(name)
    (folder / IMAGES).mkdir(parents=True)
    rng = np.random.default_rng(0)
    photographs = []
    for index, azimuth in enumerate(np.linspace(0, np.deg2rad(200), registered)):
        place = CENTER_M + 3.5 * np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
        photographs.append(
            Photograph(
                f"view_{index}",
                f"VIEW_{index}.JPG",
                f"{index:064d}",
                look_at(place, CENTER_M),
                False,
            )
        )
    photographs.append(Photograph("lost", "LOST.JPG", "9" * 64, None, False))
    for photograph in photographs:
        noise = rng.integers(0, 255, (48, 64, 3), dtype=np.uint8)
        Image.fromarray(noise).save(folder / IMAGES / f"{photograph.name}.jpg")
    outward = rng.normal(size=(500, 3))
    outward /= np.linalg.norm(outward, axis=1, keepdims=True)
    colors = rng.integers(0, 255, (500, 3), dtype=np.uint8)
    reference = Reference(CENTER_M + 1.3 * outward, outward, colors, 0.1 * rng.random(500))
    reference.write(folder / REFERENCE_FILE)
    made = PhotographSet(
        name=name,
        folder=folder,
        camera=CameraConfig(64, 48, 60.0),
        photographs=tuple(photographs),
        height_m=2.6,
        extents_m=(2.6, 2.6, 2.6),
        metres_per_unit=0.23,
        scale_source="length",
        reference_error_m=0.05,
        halves=HalvesAgreement((50.0,) * 5, (60.0,) * 5, (54.5,) * 5),
        weak=("azimuth 60° to 90°: hardly any points",),
        notes=("6 of 7 photographs registered",),
        source_folder="photos",
    )
    made.write(folder)
    return made
