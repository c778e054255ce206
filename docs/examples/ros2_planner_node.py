"""`nbv.Planner` as a ROS 2 node: an example to start from. ``python ros2_planner_node.py --ros-args -p config:=gatetune.yaml``

Listens to ``odometry`` (the vehicle, in the planner's frame: east, north, up, the target above the origin) and to ``captures``:
JSON, after each photograph is in the sparse model:

    {"workspace": "colmap", "seeds": 24, "captures": [{"image": "01.jpg", "position_m": [4, 0, 2]}, ...]}

Publishes ``next_view`` (where the camera shall be, x forward at the target) and ``decision`` (why). Where the phase ends there is
a decision and no view.
"""

import json
import math
from pathlib import Path

import numpy as np
import pycolmap
import rclpy
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Odometry
from rclpy.node import Node
from std_msgs.msg import String

import nbv
from nbv.errors import MissionFailure, UserError
from nbv.geometry.frames import align_umeyama, camera_centers_m, heading_to
from nbv.sparse.alignment import Alignment
from nbv.sparse.colmap import camera_from_model_poses, registered_names, to_sparse_model
from nbv.types import SparseModel


def sparse_model(workspace: Path, reported_m: dict[str, np.ndarray]) -> SparseModel:
    """COLMAP's largest model in the planner's frame, aligned by the reported camera centres, one for each photograph."""
    models = [
        pycolmap.Reconstruction(str(folder)) for folder in sorted((workspace / "sparse").glob("[0-9]*"))
    ]
    largest = max(models, key=lambda model: model.num_reg_images())
    centers = camera_centers_m(camera_from_model_poses(largest))
    told_m = np.array([reported_m[Path(name).name] for name in registered_names(largest)])
    world_from_model = align_umeyama(told_m, centers)
    residuals_m = np.linalg.norm(world_from_model.apply(centers) - told_m, axis=1)
    everyone = np.arange(len(centers))
    return to_sparse_model(
        largest, Alignment(world_from_model, residuals_m, np.zeros(len(centers)), everyone)
    )


class PlannerNode(Node):
    """Answers every sparse model with the next view."""

    def __init__(self) -> None:
        super().__init__("gatetune_planner")
        self.declare_parameter("config", "gatetune.yaml")
        self.planner = nbv.Planner.from_yaml(Path(self.get_parameter("config").value))
        self.vehicle_m, self.heading_rad = None, 0.0
        self.create_subscription(Odometry, "odometry", self.on_odometry, 10)
        self.create_subscription(String, "captures", self.on_captures, 10)
        self.next_view = self.create_publisher(PoseStamped, "next_view", 10)
        self.decision = self.create_publisher(String, "decision", 10)

    def on_odometry(self, message: Odometry) -> None:
        """Where the vehicle is."""
        at, q = message.pose.pose.position, message.pose.pose.orientation
        self.vehicle_m = np.array([at.x, at.y, at.z])
        self.heading_rad = math.atan2(2 * (q.w * q.z + q.x * q.y), 1 - 2 * (q.y**2 + q.z**2))

    def on_captures(self, message: String) -> None:
        """Plan; whatever goes wrong is logged in one line, and the next message is another chance."""
        if self.vehicle_m is None:
            self.get_logger().warning("no odometry yet: nothing is planned")
            return
        try:
            told = json.loads(message.data)
            positions = {c["image"]: np.array(c["position_m"], dtype=float) for c in told["captures"]}
            model = sparse_model(Path(told["workspace"]), positions)
            visited = np.array(list(positions.values()))
            plan = self.planner.plan(model, visited, int(told["seeds"]), self.vehicle_m, self.heading_rad)
        except (OSError, ValueError, KeyError, TypeError, RuntimeError, MissionFailure, UserError) as error:
            self.get_logger().error(f"nothing is planned: {type(error).__name__}: {error}")
            return
        if plan.next_view is not None:
            self.next_view.publish(self.pose(np.array(plan.next_view.position_m)))
        self.decision.publish(String(data=plan.decision.reason if plan.decision else plan.end))

    def pose(self, position_m: np.ndarray) -> PoseStamped:
        """A camera there that looks at the target: turned about z, then pitched."""
        target_m = np.array(self.planner.config.target_m)
        yaw = float(heading_to(position_m, target_m))
        delta = target_m - position_m
        down = math.atan2(-delta[2], math.hypot(*delta[:2]))
        message = PoseStamped()
        message.header.stamp = self.get_clock().now().to_msg()
        message.header.frame_id = "map"
        at, q = message.pose.position, message.pose.orientation
        at.x, at.y, at.z = map(float, position_m)
        sy, cy, sp, cp = math.sin(yaw / 2), math.cos(yaw / 2), math.sin(down / 2), math.cos(down / 2)
        q.x, q.y, q.z, q.w = -sy * sp, cy * sp, sy * cp, cy * cp
        return message


def main() -> None:
    """Until Ctrl-C."""
    rclpy.init()
    rclpy.spin(PlannerNode())


if __name__ == "__main__":
    main()
