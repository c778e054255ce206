"""The ROS 2 node of the documentation, its logic run without ROS: of rclpy only the calls that it uses, faked."""

import importlib.util
import json
import sys
from pathlib import Path
from types import SimpleNamespace
from unittest.mock import MagicMock

import numpy as np
import pytest
import yaml
from colmap_workspace import write_workspace

from nbv import Planner
from nbv.config import preset
from nbv.viewpoints import seed_viewpoints

NODE = Path(__file__).resolve().parents[3] / "docs/examples/ros2_planner_node.py"


class Node:
    def __init__(self, name):
        self.published, self.heard, self.parameters, self.logger = {}, {}, {}, MagicMock()
        self.get_parameter, self.get_logger, self.get_clock = (
            self.parameters.get,
            lambda: self.logger,
            MagicMock(),
        )

    def declare_parameter(self, name, default):
        self.parameters[name] = SimpleNamespace(value=default)

    def create_subscription(self, kind, topic, callback, depth):
        self.heard[topic] = callback

    def create_publisher(self, kind, topic, depth):
        return SimpleNamespace(publish=self.published.setdefault(topic, []).append)


@pytest.fixture
def node(monkeypatch, tmp_path):
    own = {"Node": Node, "PoseStamped": MagicMock, "String": SimpleNamespace}
    for name in ("rclpy", "rclpy.node", "geometry_msgs.msg", "nav_msgs.msg", "std_msgs.msg"):
        monkeypatch.setitem(sys.modules, name.partition(".")[0], MagicMock())
        monkeypatch.setitem(sys.modules, name, MagicMock(**own))
    spec = importlib.util.spec_from_file_location("ros2_planner_node", NODE)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    monkeypatch.chdir(tmp_path)
    Path("gatetune.yaml").write_text(yaml.safe_dump(preset("paper").to_dict()))
    return module.PlannerNode()


def captures(folder):
    views = [np.array(v.position_m) for v in seed_viewpoints(preset("paper"))]
    write_workspace(folder, views)
    named = [{"image": f"{i:02d}.jpg", "position_m": v.tolist()} for i, v in enumerate(views, 1)]
    return SimpleNamespace(data=json.dumps({"workspace": str(folder), "seeds": 24, "captures": named}))


def test_it_publishes_the_planners_view_and_logs_a_bad_message(node, tmp_path, monkeypatch):
    said = captures(tmp_path)
    node.heard["captures"](said)
    node.logger.warning.assert_called_once_with("no odometry yet: nothing is planned")
    at = SimpleNamespace(x=3.0, y=1.0, z=2.5)
    q = SimpleNamespace(w=np.cos(0.6), x=0.0, y=0.0, z=np.sin(0.6))  # heading 1.2
    pose = SimpleNamespace(position=at, orientation=q)
    node.heard["odometry"](SimpleNamespace(pose=SimpleNamespace(pose=pose)))
    assert node.heading_rad == pytest.approx(1.2)
    for text in ("{", "{}", '{"workspace": "none", "seeds": 1, "captures": []}'):
        node.heard["captures"](SimpleNamespace(data=text))
    assert node.logger.error.call_count == 3 and not node.published["next_view"]
    asked = []
    plan = Planner.plan
    monkeypatch.setattr(Planner, "plan", lambda self, *a: asked.append((a, plan(self, *a))) or asked[-1][1])
    node.heard["captures"](said)
    ((given, made),) = asked
    assert given[2] == 24 and tuple(given[3]) == (3.0, 1.0, 2.5)
    (pose,) = node.published["next_view"]
    at, turn = pose.pose.position, pose.pose.orientation
    assert (at.x, at.y, at.z) == pytest.approx(made.next_view.position_m)
    w, v = turn.w, np.array([turn.x, turn.y, turn.z])
    forward = np.array([1.0, 0, 0]) + 2 * np.cross(v, np.cross(v, (1.0, 0, 0)) + w * np.array([1.0, 0, 0]))
    delta = np.array(preset("paper").target_m) - made.next_view.position_m
    np.testing.assert_allclose(forward, delta / np.linalg.norm(delta), atol=1e-9)
    assert "f_b" in node.published["decision"][0].data
    node.heard["captures"](SimpleNamespace(data=said.data.replace('"seeds": 24', '"seeds": 99')))
    assert "n_seeds 99" in node.logger.error.call_args[0][0]
