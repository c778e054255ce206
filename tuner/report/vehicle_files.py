"""What a campaign recommends as the authors' files: what each carries, and a header that says so."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from nbv.config import MissionConfig
from nbv.errors import UserError
from nbv.provenance import git_revision, versions
from tuner.bridges.photogrammetry_nbv import (
    NoSuchGate,
    carried,
    read_file,
    write_mission,
    write_scoring,
    write_text,
)
from tuner.campaign.campaign import Campaign
from tuner.problem.observations import short
from tuner.problem.search_space import ours
from tuner.recommendation.recommendation import Recommendation

SCORING, MISSION = "scoring.yaml", "unified_mission.yaml"


@dataclass(frozen=True)
class VehicleFile:
    """One of the authors' files with the recommendation."""

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
    """Both files of what ``best`` recommends, the one that carries most first.

    ``onto``: by name a file of that kind whose other keys are kept; others are as published.

    Raises
    ------
    UserError
        The campaign's missions are not ours; a file of ``onto`` cannot be read.
    """
    if campaign.settings.mission is not None:
        raise UserError(
            f"campaign {campaign.settings.name} is of a mission that is not ours; export it as gatetune.yaml"
        )

    def build(values: Mapping[str, Any]) -> MissionConfig:
        return ours(campaign.settings.config(values))

    pairs = _changes(build, best)
    files = []
    for name, write in ((SCORING, write_scoring), (MISSION, write_mission)):
        theirs = read_file(onto[name], name) if onto and name in onto else None
        try:
            values, remarks = write(build(best.values), theirs)
            kept = carried(name, pairs)
        except NoSuchGate as error:
            files.append(VehicleFile(name, "", (), best.changed or ("gate.kind",), (str(error),)))
            continue
        lost = [path for path in best.changed if path not in kept]
        said = tuple(str(remark) for remark in remarks)
        lines = [*header(campaign, best, kept), *(f"does not transfer: {text}" for text in said)]
        text = write_text(values, name, "\n".join(lines))
        files.append(VehicleFile(name, text, tuple(kept), tuple(lost), said))
    return sorted(files, key=lambda file: -len(file.carried))


def change_text(best: Recommendation, path: str) -> str:
    """``seed.count 14 (default 24)``."""
    return f"{path} {short(best.values[path])} (default {short(best.default_values[path])})"


def header(campaign: Campaign, best: Recommendation, kept: Sequence[str]) -> list[str]:
    """Where a file is from, which changes it carries, and what they were worth where it carries all of them."""
    s, changed = campaign.settings, best.changed
    lines = [
        f"gatetune {versions().get('gatetune', 'unknown')}, revision {git_revision()}",
        f"campaign {s.name}: space {s.space.name}, {len(s.rocks)} rocks, {s.budget} missions, "
        f"fidelity {s.fidelity}, metric {s.objective.metric}",
    ]
    if not changed:
        return [*lines, "recommended: keep the default; this file changes nothing of it"]
    lines += [f"carries: {change_text(best, path)}" for path in kept]
    missing = [path for path in changed if path not in kept]
    lines += [f"does not carry: {change_text(best, path)}" for path in missing]
    if missing:
        return [*lines, f"what {len(kept)} of {len(changed)} changes are worth alone was not measured"]
    low, high = best.improvement_interval_95
    sure = "" if low == high else f" [{low:+.2f}, {high:+.2f}] (95 %)"
    return [
        *lines,
        f"gain over the default on the training rocks, {best.metric}: {best.improvement:+.2f}{sure}",
    ]


def _changes(
    build: Callable[[Mapping[str, Any]], MissionConfig], best: Recommendation
) -> dict[str, tuple[MissionConfig, MissionConfig]]:
    """Per changed parameter the recommendation and the same without it; where that is none, the default with and without."""
    pairs, default = {}, best.default_values
    for path in best.changed:
        try:
            pairs[path] = build(best.values), build({**best.values, path: default[path]})
        except UserError:
            pairs[path] = build({**default, path: best.values[path]}), build(default)
    return pairs
