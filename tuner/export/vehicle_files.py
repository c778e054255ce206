"""Configurations as files: what a campaign recommends in the authors' files and in gatetune's, each with a header that says so."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from nbv.config import IDEAL, PRESETS, Declaration, MissionConfig, parameter
from nbv.errors import UserError
from nbv.provenance import git_revision, versions
from nbv.safe_files import to_yaml
from tuner.campaign.campaign import Campaign
from tuner.campaign.settings import CampaignSettings
from tuner.export.photogrammetry_nbv import read_file, write_mission, write_scoring, write_text
from tuner.missions.external.mission_file import ExternalConfig
from tuner.problem.baselines import label as strategy_label
from tuner.problem.observations import short
from tuner.problem.search_space import builtin
from tuner.recommendation.recommendation import Recommendation

SCORING, MISSION, OURS = "scoring.yaml", "unified_mission.yaml", "gatetune.yaml"
WRITERS = {SCORING: write_scoring, MISSION: write_mission}


@dataclass(frozen=True)
class VehicleFile:
    name: str
    text: str
    carried: tuple[str, ...]  # changed parameters that it carries
    lost: tuple[str, ...]  # those that it does not
    remarks: tuple[str, ...]  # what cannot be said there, a line each

    @property
    def useful(self) -> bool:
        """Whether it carries a change, or there is none to carry."""
        return bool(self.carried) or not self.lost

    @property
    def share(self) -> str:
        """``2 of 3 changes, not pool.max_altitude_m``."""
        if not self.useful:
            return "none of the changes"
        if not self.carried:
            return "the default"
        lost = f", not {', '.join(self.lost)}" if self.lost else ""
        return f"{len(self.carried)} of {len(self.carried) + len(self.lost)} changes{lost}"


def vehicle_files(
    campaign: Campaign, best: Recommendation, onto: Mapping[str, Path] | None = None
) -> list[VehicleFile]:
    """What ``best`` recommends as every file there is: the authors' by what they carry, gatetune's, those that carry nothing.

    ``onto``: by name a file of the authors' kind whose other keys are kept; others are as published.

    Raises `UserError`: a file of ``onto`` cannot be read.
    """
    s = campaign.settings
    only = s.conditions[0].name if len(s.conditions) == 1 else IDEAL
    config = s.problem.config(best.values, only)
    header = "\n".join(_header(campaign, best, best.changed))  # a name may hold a new line
    comment = "".join(f"# {line}\n" for line in header.splitlines())
    if isinstance(config, ExternalConfig):
        text = to_yaml(dict(config.values))
        return [VehicleFile(OURS, comment + text, best.changed, (), ())]
    text = "\n".join(commented_yaml(builtin(config)))
    own = VehicleFile(OURS, f"{comment}{text}\n", best.changed, (), ())
    theirs = sorted(
        (_their_file(name, campaign, best, (onto or {}).get(name)) for name in WRITERS),
        key=lambda file: -len(file.carried),
    )
    return [*(f for f in theirs if f.useful), own, *(f for f in theirs if not f.useful)]


def _their_file(name: str, campaign: Campaign, best: Recommendation, onto: Path | None) -> VehicleFile:
    theirs = read_file(onto, name) if onto is not None else None
    try:
        values, remarks = WRITERS[name](builtin(campaign.settings.problem.config(best.values)), theirs)
        kept = _carried(name, campaign.settings, best)
    except UserError as error:  # the gate does not exist there
        return VehicleFile(name, "", (), best.changed or ("gate.kind",), (str(error),))
    said = tuple(str(remark) for remark in remarks)
    lines = [*_header(campaign, best, kept), *(f"does not transfer: {text}" for text in said)]
    lost = tuple(path for path in best.changed if path not in kept)
    return VehicleFile(name, write_text(values, name, "\n".join(lines)), tuple(kept), lost, said)


def _carried(name: str, s: CampaignSettings, best: Recommendation) -> list[str]:
    """The changes that a file carries: without them it would say something else.

    A change is taken out of the recommendation; where the rest is no valid configuration without it, it is put into the default.
    """
    write, found, default = WRITERS[name], [], best.default_values
    for path in best.changed:
        pair = best.values, {**best.values, path: default[path]}
        try:
            with_it, without = (builtin(s.problem.config(values)) for values in pair)
        except UserError:
            pair = {**default, path: best.values[path]}, default
            with_it, without = (builtin(s.problem.config(values)) for values in pair)
        (values, remarks), (before, remarks_before) = write(with_it), write(without)
        if path in {remark.key for remark in remarks if not remark.partly}:
            continue
        if values != before or path in {remark.key for remark in remarks_before}:
            found.append(path)
    return found


def change_text(best: Recommendation, path: str) -> str:
    """``seed.count 14 (default 24)``."""
    return f"{path} {short(best.values[path])} (default {short(best.default_values[path])})"


def _header(campaign: Campaign, best: Recommendation, kept: Sequence[str]) -> list[str]:
    """Where a file is from, which changes it carries, and what they were worth where it carries all of them."""
    s, changed = campaign.settings, best.changed
    lines = [
        f"gatetune {versions().get('gatetune', 'unknown')}, revision {git_revision()}",
        f"campaign {s.name}: space {s.space.name}, {len(s.rocks)} rocks, {s.budget} missions, "
        f"fidelity {s.fidelity}, metric {s.objective.metric}",
    ]
    if math.isnan(best.improvement):
        return [*lines, f"{strategy_label(best.plain)}, not the campaign's recommendation"]
    if not changed:
        return [*lines, "recommended: keep the default, which this file has"]
    lines += [f"carries: {change_text(best, path)}" for path in kept]
    missing = [path for path in changed if path not in kept]
    lines += [f"does not carry: {change_text(best, path)}" for path in missing]
    if missing:
        return [*lines, f"the gain of {len(kept)} of the {len(changed)} changes alone was not measured"]
    low, high = best.improvement_interval_95
    sure = "" if low == high else f" [{low:+.3g}, {high:+.3g}] (95 %)"
    gain = f"{best.metric}: {best.improvement:+.3g}{sure}"
    return [*lines, f"gain over the default on the training rocks, {gain}"]


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
