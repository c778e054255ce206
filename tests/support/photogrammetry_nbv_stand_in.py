"""What the authors' stack does as far as our runner can tell: ``python THIS px4|agent|bridge|node ...``.

ROS, PX4 and Gazebo were not to be had where this was written. Every behaviour cites its source: F is the fact sheet
`upstream_bridge.md` (repository photogrammetry_nbv, b8e106c), ucn their ``unified_controller_node.py``. It needs nothing but
Python and PyYAML. STAND_IN_FAULT chooses how it misbehaves; the cloud is best at a novelty weight of 0.2.
"""

import json
import math
import os
import re
import struct
import sys
import time
from pathlib import Path

SCALE, SHIFT = 0.3, (5.0, -2.0, 1.0)  # of COLMAP's frame, turned by a quarter about z (F: any similarity)
LEVER_UP_M = 0.098  # F, camera facts: above base_link
BALL_M = 0.8


def take_the_place(mission_file, fault, fixed, agent=None):
    """Rewrite the shipped mission file: this program instead of the stack, a ball instead of the rock."""
    import trimesh
    import yaml

    tree = yaml.safe_load(mission_file.read_text())
    folder, instance = mission_file.parent, tree["instances"][0]
    stack = instance["stack"]
    for name, program in stack["start"].items():
        arguments = program["command"].partition("unified_controller_node")[2]
        options = "" if name == "node" else "-I -S"
        role = "node" if name == "node" else "service"
        stack["start"][name] = {"command": f"{sys.executable} {options} {__file__} {role} {arguments}"}
    if agent:
        stack["start"]["agent"]["command"] = agent
    scripts = folder.parent / "scripts"
    scripts.mkdir()
    stack |= {
        "colmap_script_dir": str(scripts),
        "camera_forward_m": 0.0,
        "start_limit_s": 1 if fault == "silent" else 60,
    }
    stack["environment"] = {"STAND_IN_FAULT": fault}
    instance |= {"mesh": "ball.ply"}
    del instance["mesh_scale"]
    instance["set"] |= {"stop.adaptive_budget": 3, **fixed}
    tree |= {
        "score": {"set": {"evaluation.gt_samples": 2000}},
        "time_limit_s": 120,
        "stop_grace_s": 0.5,
        "replicates": 1,
    }
    flown = ("covis.weights.nov", "covis.weights.move", "pool.max_altitude_m")
    tree["parameters"] = {name: tree["parameters"][name] for name in flown}
    trimesh.creation.icosphere(4, radius=BALL_M).export(folder / "ball.ply")
    mission_file.write_text(yaml.safe_dump(tree))


def colmap(enu):
    """East, north, up from below the rock, in COLMAP's frame."""
    e, n, u = enu
    return (-SCALE * n + SHIFT[0], SCALE * e + SHIFT[1], SCALE * u + SHIFT[2])


def hang():
    """Trap (F): the node never exits, nor do PX4, agent and bridges."""
    while True:
        time.sleep(60)


def service():
    """PX4, the agent and the bridges: they need numbers of their own (F: ROS domain and ports per mission)."""
    assert os.environ["ROS_DOMAIN_ID"] and os.environ["PX4_UXRCE_DDS_PORT"] and os.environ["GZ_PARTITION"]
    hang()


def node(arguments):
    """``--ros-args --params-file M -p scoring_config_path:=S -p output_root:=O`` (F, One mission, 4)."""
    import yaml

    fault = os.environ.get("STAND_IN_FAULT", "")
    file = arguments[arguments.index("--params-file") + 1]
    p = yaml.safe_load(Path(file).read_text())["/**"]["ros__parameters"]
    p.update(word.split(":=") for word in arguments if ":=" in word)
    scorer = yaml.safe_load(Path(p["scoring_config_path"]).read_text())["scorer"]
    # F: request files are written into colmap_script_dir, so two missions in one folder would mix them up.
    (request := Path(p["colmap_script_dir"]) / "bootstrap_request.json").write_text("{}")
    if fault == "silent":  # ucn WAIT_FOR_TOPICS: waits for a position for ever
        hang()
    run = Path(p["output_root"]) / time.strftime("unified_run_%Y%m%d_%H%M%S")  # F: output, writes where told
    for name in (
        "seed/images",
        "seed/metadata",
        "adaptive/images",
        "adaptive/metadata",
        "final",
        "colmap/sparse/0",
    ):
        (run / name).mkdir(parents=True)
    rock = [float(p[f"rock_center_{axis}"]) for axis in "xyz"]
    cameras = []

    def photograph(kind, index, label, elevation, azimuth):
        radius, (up, flat) = 4.0, (math.sin(elevation), math.cos(elevation))
        at = (
            rock[0] + radius * flat * math.cos(azimuth),
            rock[1] + radius * flat * math.sin(azimuth),
            rock[2] - radius * up,
        )
        name = f"{index:02d}_{label}_0000000001_000000000.{p['image_format']}"
        (run / kind / "images" / name).write_bytes(b"photograph")
        entry = {
            "image_file": name,
            "vehicle_position_ned_m": dict(zip("xyz", at)),
            "vehicle_heading_rad": 0.0,
        }
        (run / kind / "metadata" / f"{index:02d}.json").write_text(json.dumps(entry))
        cameras.append((name, colmap((at[1] - rock[1], at[0] - rock[0], LEVER_UP_M - at[2]))))

    views = [
        (e, k, n) for e, n in zip(p["seed_elevation_rings_deg"], p["seed_azimuth_counts"]) for k in range(n)
    ]
    for i, (elevation, k, n) in enumerate(views):
        photograph("seed", i, f"ring_{i:02d}", math.radians(elevation), 2 * math.pi * k / n)
    manifest = {"rock_center_ned_m": dict(zip("xyz", rock))}
    (run / "phase2_manifest.json").write_text(json.dumps(manifest)[: 20 if fault == "half" else None])
    if fault == "floods":  # a log level of debug
        print("debug " * 100_000, flush=True)
        hang()
    if fault == "campaign":  # a fault of each kind, one after the other
        with Path("flown").open("a+") as count:
            count.write(".")
            fault = {2: "dies", 4: "hangs", 5: "none"}.get(count.tell(), "")
    if fault == "dies":  # trap (F): dies in the middle
        raise SystemExit("[ERROR] segmentation fault")
    nov = float(scorer["weights"]["novelty"])
    top = -float(p["min_altitude_ned"])
    if fault == "hangs":  # a COLMAP thread that never returns (ucn UPDATE_PROJECT)
        hang()
    budget = int(p["image_budget"])
    if fault == "lands":  # trap (F): an error also lands and reconstructs (ucn UPDATE_PROJECT -> RETURN_HOME)
        print("[Phase2] COLMAP incremental_update failed: exit status 1", flush=True)
        budget = 1
    # Table (F): max_altitude_ned is a lower limit of height; the wrong way round nothing is left (ucn, empty pool).
    # So is it where all are too far away (ucn, travel filter).
    none = -float(p["max_altitude_ned"]) > top or float(p["max_candidate_travel_m"]) < 0.5
    if none or fault == "none":
        print("[Phase2] No feasible candidates after filtering. Returning home.", flush=True)
        budget = 0
    for i in range(budget):
        photograph("adaptive", i, f"cand_{i:03d}", 0.5, 0.7 * i)
    if budget == int(p["image_budget"]):
        print("[Phase2] Stopping: image_budget", flush=True)
    write_model(run / "colmap/sparse/0", cameras)
    if (
        fault != "dense"
    ):  # where that fails, the log says so and the mission goes on (ucn OFFLINE_DENSE_RECON)
        write_ply(run / "final/dense_cloud.ply", ball(lowest=-1.0 + min(1.2, abs(math.log(nov / 0.2)) / 1.5)))
    write_ply(run / "final/seed_sparse_cloud.ply", ball(lowest=0.9))  # last of all (ucn SEED_SPARSE_RECON)
    assert re.search("colmap_scripts", str(request))  # not the original folder
    hang()


def ball(lowest):
    """Points of a ball where the rock is, but for what lies below ``lowest`` radii."""
    golden = math.pi * (3 - math.sqrt(5))
    for i in range(4000):
        z = 1 - 2 * (i + 0.5) / 4000
        flat = math.sqrt(1 - z * z)
        if z >= lowest:
            yield colmap(
                (
                    BALL_M * flat * math.cos(golden * i),
                    BALL_M * flat * math.sin(golden * i),
                    BALL_M * (1 + z),
                )
            )


def write_ply(path, points):
    """ASCII PLY."""
    points = list(points)
    head = f"ply\nformat ascii 1.0\nelement vertex {len(points)}\n"
    head += "".join(f"property float {axis}\n" for axis in "xyz")
    path.write_text(head + "end_header\n" + "".join(f"{x:.6f} {y:.6f} {z:.6f}\n" for x, y, z in points))


def write_model(folder, cameras):
    """COLMAP's binary model without points: one PINHOLE camera an image (F 3.1), no rotation."""
    with (folder / "cameras.bin").open("wb") as file:
        file.write(struct.pack("<Q", len(cameras)))
        for i in range(1, len(cameras) + 1):
            file.write(struct.pack("<iiQQdddd", i, 1, 640, 480, 465.7, 465.7, 320.0, 240.0))
    with (folder / "images.bin").open("wb") as file:
        file.write(struct.pack("<Q", len(cameras)))
        for i, (name, centre) in enumerate(cameras, 1):
            file.write(struct.pack("<idddddddi", i, 1, 0, 0, 0, *(-c for c in centre), i))
            file.write(name.encode() + b"\0" + struct.pack("<Q", 0))
    (folder / "points3D.bin").write_bytes(struct.pack("<Q", 0))


if __name__ == "__main__":
    node(sys.argv[2:]) if sys.argv[1] == "node" else service()
