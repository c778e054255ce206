"""Configurations as files: what a campaign recommends in the authors' files and in gatetune's, each with a header that says so."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from nbv.config import PRESETS, Declaration, MissionConfig, parameter, under
from nbv.errors import UserError
from nbv.provenance import git_revision, versions
from nbv.safe_files import to_yaml
from tuner.campaign.campaign import Campaign
from tuner.export.photogrammetry_nbv import PARAMETERS, write_mission, write_scoring, write_text
from tuner.problem.baselines import label as strategy_label
from tuner.problem.goal import by_dotted_path
from tuner.problem.observations import changes, short
from tuner.problem.search_space import value_at
from tuner.recommendation.recommendation import Recommendation

SCORING, MISSION, OURS = "scoring.yaml", "unified_mission.yaml", "gatetune.yaml"
WRITERS = {SCORING: write_scoring, MISSION: write_mission}


@dataclass(frozen=True)
class Exported:
    """A configuration that a vehicle is to fly, and the campaign that it is from."""

    campaign: Campaign
    strategy: str  # which plan it is: a tuned configuration's name, or a baseline's
    config: MissionConfig  # under no condition
    best: Recommendation | None = None  # that it is; None for a baseline

    @cached_property
    def default(self) -> MissionConfig:
        problem = self.campaign.settings.problem
        return problem.config(problem.default)

    @cached_property
    def values(self) -> dict[str, Any]:
        """The values that differ from the default's and have an effect, by path."""
        values, default = (by_dotted_path(config.to_dict()) for config in (self.config, self.default))
        return {path: values[path] for path in changes(values, {**values, **default})}

    def change(self, path: str) -> str:
        """``seeds 14 (default 24)``."""
        values = (short(value_at(config, path)) for config in (self.config, self.default))
        return "{} {} (default {})".format(path, *values)


@dataclass(frozen=True)
class VehicleFile:
    name: str
    text: str  # empty: what is exported does not exist there
    carried: tuple[str, ...]  # changed parameters that it has a place for
    lost: tuple[str, ...]  # those that it has not
    remarks: tuple[str, ...] = ()  # what cannot be texts there, a line each

    @property
    def share(self) -> str:
        """``2 of 3 changes, not pool.max_altitude_m``."""
        lost = f", not {', '.join(self.lost)}" if self.lost else ""
        return f"{len(self.carried)} of {len(self.carried) + len(self.lost)} changes{lost}"


def vehicle_files(exported: Exported) -> list[VehicleFile]:
    """The configuration as every file there is: the authors' two and gatetune's; of the authors' one without text where it does not exist there."""
    config, conditions = exported.config, exported.campaign.settings.conditions
    lines = commented_yaml(under(config, conditions[0]) if len(conditions) == 1 else config)
    changed = tuple(exported.values)
    ours = VehicleFile(OURS, "\n".join((*_header(exported, changed), *lines, "")), changed, ())
    theirs = list[VehicleFile]()
    for name, write in WRITERS.items():
        try:
            values, remarks = write(config)
        except UserError as error:  # the gate does not exist there
            theirs.append(VehicleFile(name, "", (), changed, (str(error),)))
            continue
        missing = {remark.key for remark in remarks if not remark.partly}
        carried = tuple(path for path in changed if path in PARAMETERS[name] and path not in missing)
        texts = tuple(str(remark) for remark in remarks)
        header = [*_header(exported, carried), *(f"# does not transfer: {text}" for text in texts)]
        text = "\n".join((*header, write_text(values, name)))
        lost = tuple(path for path in changed if path not in carried)
        theirs.append(VehicleFile(name, text, carried, lost, texts))
    return [*theirs, ours]


def _header(exported: Exported, carried: tuple[str, ...]) -> list[str]:
    """Comment lines: where a file is from, which changes it carries, and what they were worth where it carries all of them."""
    s, best, changed = exported.campaign.settings, exported.best, exported.values
    lines = [
        f"gatetune {versions().get('gatetune', 'unknown')}, revision {git_revision()}",
        f"campaign {s.name}: space {s.space.name}, {len(s.rocks)} rocks, {s.budget} missions, "
        f"fidelity {s.fidelity}, metric {s.objective.metric}",
    ]
    missing = [path for path in changed if path not in carried]
    lines += [f"carries: {exported.change(path)}" for path in carried]
    lines += [f"does not carry: {exported.change(path)}" for path in missing]
    lines.append(strategy_label(exported.strategy))
    if best is None:
        pass
    elif not changed:
        lines.append("nothing was found to be better than the default, which this file has")
    elif missing:
        lines.append(f"the gain of {len(carried)} of the {len(changed)} changes alone was not measured")
    else:
        low, high = best.improvement_interval_95
        sure = "" if low == high else f" [{low:+.3g}, {high:+.3g}] (95 %)"
        gain = f"{best.metric}: {best.improvement:+.3g}{sure}"
        lines.append(f"gain over the default on the training rocks, {gain}")
    return [f"# {line}" for line in "\n".join(lines).splitlines()]  # a name may hold a new line


# -- gatetune's file ----------------------------------------------------------------------------------------------


def commented_yaml(config: MissionConfig) -> list[str]:
    """The configuration as lines of YAML, beside every value its unit, meaning and source."""
    rows = list(_rows(config.to_dict(), "", config.preset))
    width = max(len(line) for line, comment in rows if comment)
    return [f"{line:<{width}}  # {comment}" if comment else line for line, comment in rows]


def _rows(tree: Mapping[str, Any], prefix: str, preset: str) -> Iterator[tuple[str, str]]:
    indent = "  " * prefix.count(".")
    for name, value in tree.items():
        if isinstance(value, dict):
            yield f"{indent}{name}:", ""
            yield from _rows(value, f"{prefix}{name}.", preset)
        else:
            about = parameter(f"{prefix}{name}")
            flow = None if isinstance(value, list) else False  # a list in its line
            text = to_yaml({name: value}, default_flow_style=flow).strip()
            unit = f"{about.unit}; " if about.unit else ""
            yield f"{indent}{text}", f"{unit}{about.meaning} ({source_of(about, value, preset)})"


def source_of(about: Declaration, value: Any, preset: str) -> str:
    """Where a value is from: text (the paper), code (the authors' public code), gatetune, or ``--set``."""
    default = list(about.default) if isinstance(about.default, tuple) else about.default
    if about.path == "preset" or value == default:
        return about.origin
    if value == PRESETS[preset].values.get(about.path):
        return f"{PRESETS[preset].source}, preset {preset}"
    return "--set"
