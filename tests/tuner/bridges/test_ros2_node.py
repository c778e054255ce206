"""The ROS 2 node of the documentation, its logic run without ROS: of rclpy only the calls that it uses, faked."""

import importlib.util
import json
import sys
import types
from pathlib import Path

import numpy as np
import pytest
import yaml
from colmap_workspace import write_workspace

from nbv import Planner
from nbv.config import preset
from nbv.viewpoints import seed_viewpoints

NODE = Path(__file__).resolve().parents[3] / "docs/examples/ros2_planner_node.py"


class Message:
    """Fields appear as they are asked for."""

    def __init__(self, **fields):
        vars(self).update(fields)

    def __getattr__(self, name):
        setattr(self, name, Message())
        return vars(self)[name]


class Node:
    def __init__(self, name):
        self.published, self.logged, self.heard, self.parameters = {}, [], {}, {}

    def declare_parameter(self, name, default):
        self.parameters.setdefault(name, Message(value=default))

    def get_parameter(self, name):
        return self.parameters[name]

    def create_subscription(self, kind, topic, callback, depth):
        self.heard[topic] = callback

    def create_publisher(self, kind, topic, depth):
        return types.SimpleNamespace(publish=self.published.setdefault(topic, []).append)

    def get_logger(self):
        return types.SimpleNamespace(warning=self.logged.append, error=self.logged.append)

    def get_clock(self):
        return types.SimpleNamespace(now=lambda: types.SimpleNamespace(to_msg=lambda: 0))


@pytest.fixture
def node(monkeypatch, tmp_path):
    fakes = {
        "rclpy": {},
        "rclpy.node": {"Node": Node},
        "geometry_msgs": {},
        "geometry_msgs.msg": {"PoseStamped": Message},
        "nav_msgs": {},
        "nav_msgs.msg": {"Odometry": Message},
        "std_msgs": {},
        "std_msgs.msg": {"String": Message},
    }
    for name, content in fakes.items():
        monkeypatch.setitem(sys.modules, name, types.ModuleType(name))
        vars(sys.modules[name]).update(content)
    spec = importlib.util.spec_from_file_location("ros2_planner_node", NODE)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    monkeypatch.chdir(tmp_path)
    Path("gatetune.yaml").write_text(yaml.safe_dump(preset("paper").to_dict()))
    return module.PlannerNode()


def captures(folder):
    views = [np.array(v.position_m) for v in seed_viewpoints(preset("paper"))]
    write_workspace(folder, views)
    named = [{"image": f"{i:02d}.jpg", "position_m": v.tolist()} for i, v in enumerate(views, 1)]
    return Message(data=json.dumps({"workspace": str(folder), "seeds": 24, "captures": named}))


def test_it_publishes_the_planners_view(node, tmp_path, monkeypatch):
    said = captures(tmp_path)
    node.heard["captures"](said)
    assert node.logged == ["no odometry yet: nothing is planned"] and not node.published["next_view"]
    q = Message(w=np.cos(0.6), x=0.0, y=0.0, z=np.sin(0.6))  # heading 1.2
    node.heard["odometry"](
        Message(pose=Message(pose=Message(position=Message(x=3.0, y=1.0, z=2.5), orientation=q)))
    )
    assert node.heading_rad == pytest.approx(1.2)
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


@pytest.mark.parametrize("text", ["{", "{}", '{"workspace": "none", "seeds": 1, "captures": []}'])
def test_a_bad_message_is_one_line_in_the_log(node, text):
    node.vehicle_m = np.zeros(3)
    node.heard["captures"](Message(data=text))
    assert (
        len(node.logged) == 1
        and node.logged[0].startswith("nothing is planned")
        and not node.published["decision"]
    )
