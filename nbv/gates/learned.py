"""A learned switch: a small decision tree in a JSON file that a person can read.

The file holds ``{"type": "decision_tree", "version": 1, "root": NODE}``. A node is either
``{"feature": NAME, "threshold": X, "left": NODE, "right": NODE}`` (left if the value is at most X) or a
leaf ``{"scorer": NAME, "probability": P}``, P being the share of training samples in that
leaf that agree with its scorer. Other keys (how it was trained, on what) are for people and ignored.

Without a file of one's own, the policy that comes with the package is used: ``policies/default.json``, made
by ``python -m research.learn_gate`` of commit ccd4413c; it names the training rocks and how it fared on rocks that it had not seen.
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any

from nbv.config import SCORERS
from nbv.errors import UserError
from nbv.gates.base import Gate
from nbv.gates.features import FEATURE_NAMES, gate_features
from nbv.safe_files import parse_json, read_json
from nbv.types import CandidatePool, GateDecision, PlanningState, Ranking


def shipped_policy() -> dict[str, Any]:
    """The policy that comes with the package: its tree, what it was trained on, how it fared."""
    text = resources.files("nbv.gates").joinpath("policies", "default.json").read_text(encoding="utf-8")
    policy: dict[str, Any] = parse_json(text, "the policy that comes with the package")
    return policy


def policy_digest(root: dict[str, Any]) -> str:
    """12 hex digits that identify a tree; a mission's trace holds them, since a policy file may change."""
    return hashlib.sha256(json.dumps(root, sort_keys=True).encode()).hexdigest()[:12]


def check_policy(policy: Any, source: str) -> dict[str, Any]:
    """The root node of a policy; ``UserError`` (naming ``source`` and the node) if it is not well formed."""
    if not isinstance(policy, dict) or policy.get("type") != "decision_tree":
        raise UserError(f'{source} is not a policy; it must be a JSON object with "type": "decision_tree"')
    if policy.get("version") != 1:
        raise UserError(
            f"{source} has policy version {policy.get('version')!r}; this program reads version 1"
        )
    _check_node(policy.get("root"), source, "root")
    root: dict[str, Any] = policy["root"]
    return root


def _check_node(node: Any, source: str, where: str) -> None:
    if not isinstance(node, dict):
        raise UserError(f"{source}: {where} is missing or not an object")
    if "scorer" in node:
        if node["scorer"] not in SCORERS:
            raise UserError(
                f"{source}: {where} names scorer {node['scorer']!r}; there are {', '.join(SCORERS)}"
            )
        if not _is_number(node.get("probability")) or not 0.0 <= node["probability"] <= 1.0:
            raise UserError(f'{source}: {where} needs a "probability" between 0 and 1')
        return
    if node.get("feature") not in FEATURE_NAMES:
        raise UserError(
            f"{source}: {where} asks for feature {node.get('feature')!r}; there are {', '.join(FEATURE_NAMES)}"
        )
    if not _is_number(node.get("threshold")):
        raise UserError(f'{source}: {where} needs a number as "threshold"')
    for side in ("left", "right"):
        _check_node(node.get(side), source, f"{where}.{side}")


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool) and value == value


@dataclass
class LearnedGate(Gate):
    """Walks the tree at every iteration. Deployable: features come from the sparse model alone.

    ``UserError`` where the configuration's policy file is missing or malformed.
    """

    def __post_init__(self) -> None:
        path = self.config.gate.learned_policy
        policy = read_json(Path(path)) if path else shipped_policy()
        self.root = check_policy(policy, path or "the shipped policy")

    def decide(self, state: PlanningState, pool: CandidatePool, rankings: dict[str, Ranking]) -> GateDecision:
        """The leaf's scorer; the path walked is the reason."""
        features = gate_features(state, self.config)
        node, steps = self.root, []
        while "scorer" not in node:
            name, threshold = node["feature"], node["threshold"]
            left = features[name] <= threshold
            steps.append(f"{name} {features[name]:.4g} {'<=' if left else '>'} {threshold:.4g}")
            node = node["left" if left else "right"]
        details = {
            "features": features,
            "probability": float(node["probability"]),
            "policy": policy_digest(self.root),
        }
        return GateDecision(rankings[node["scorer"]], ", ".join(steps) or "a tree of one leaf", details)
