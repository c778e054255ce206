"""The contract tried before a night is spent on it: each part with a verdict."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from nbv.errors import MissionFailure
from nbv.mission.result import MissionResult
from tuner.missions.external.configuration import external_config
from tuner.missions.external.contract import Request
from tuner.missions.external.flying import Flown, fly_request
from tuner.missions.external.mission_file import MissionFile
from tuner.missions.external.runner import HARDLY_OVERLAP, OUTPUT, UNTIDY, run_external_mission
from tuner.missions.external.slots import slots_of, take_slot
from tuner.problem.objective import dotted

_WAIT_S = 5.0
_SHARE_OF_WALL = 0.3  # of a mission's time, after which the rehearsal stops one
_SHORTEST_S = 0.02
_TIME_OUTS = 4
_TOO_SHORT_S = 0.25  # a few times as long as it takes to start a process and to look at it


@dataclass(frozen=True)
class Verdict:
    """What one part of the rehearsal found."""

    part: str
    kind: Literal["ok", "warning", "failed"]
    text: str


def rehearse(mission: MissionFile, folder: Path) -> Iterator[Verdict]:
    """Fly the default twice, a failure and one that is stopped, all in ``folder``; a verdict after each.

    Raises
    ------
    UserError
        The command cannot be run.
    """
    space = f"{mission.space.dimension} parameters"
    yield Verdict(
        "mission file",
        "ok",
        f"{space}, {len(mission.instances)} instances to tune on, {len(mission.held_out)} held out",
    )
    flown: list[MissionResult] = []
    for part in ("the default", "the same again"):
        verdict, result = _fly_default(mission, folder / part.replace(" ", "-"), part, flown)
        yield verdict
        if result is None:
            return
        flown.append(result)
    yield _failure(_fly(mission, folder / "failure", check="fail"))
    limit_s = max(_SHORTEST_S, _SHARE_OF_WALL * flown[0].costs["wall_s"])
    stopped = _fly(mission, folder / "time-out", limit_s=limit_s)
    # The default may have been flown on a busier machine than this one: a shorter limit then.
    for attempt in range(2, _TIME_OUTS + 1):
        if stopped.ended.timed_out:
            break
        limit_s = _SHARE_OF_WALL * stopped.ended.wall_s
        stopped = _fly(mission, folder / f"time-out-{attempt}", limit_s=limit_s)
    yield _time_out(mission, stopped, limit_s)
    yield _clean_up(flown, stopped)


def _fly_default(
    mission: MissionFile, directory: Path, part: str, before: list[MissionResult]
) -> tuple[Verdict, MissionResult | None]:
    instance = mission.instances[0].name
    try:
        result = run_external_mission(external_config(mission), instance, 0, directory, keep="all")
    except MissionFailure as failure:
        return Verdict(part, "failed", f"{failure.reason}: {failure.message}"), None
    if result.status == "failed":
        return Verdict(
            part, "failed", f"the default configuration failed: {result.reason} {result.message}".rstrip()
        ), None
    value = mission.objective.measure(result.metrics)
    if value is None:
        there = ", ".join(dotted(result.metrics)) or "none"
        return Verdict(part, "failed", f"no metric {mission.objective.metric!r}; there are {there}"), None
    text = f"{mission.objective.metric} = {value:.6g} on {instance!r} in {result.costs['wall_s']:.2f} s"
    if result.reason == HARDLY_OVERLAP:
        return Verdict(part, "warning", f"{text}, but {result.message}"), result
    if not before:
        return Verdict(part, "ok", text), result
    first = mission.objective.measure(before[0].metrics)
    assert first is not None
    if value == first:
        return Verdict(part, "ok", f"{text}: the same number, it repeats exactly"), result
    share = abs(value - first) / max(abs(first), 1e-300)
    note = "" if mission.replicates > 1 else "; replicates: 2 or more would average it"
    text = f"{text}: differs by {abs(value - first):.3g} ({100 * share:.2g} %) at the same seed{note}"
    return Verdict(part, "ok" if mission.replicates > 1 else "warning", text), result


def _fly(mission: MissionFile, directory: Path, *, check: str = "", limit_s: float | None = None) -> Flown:
    with take_slot(mission, slots_of(mission), _WAIT_S) as slot:
        values, instance = external_config(mission).values, mission.instances[0].name
        output = (directory / OUTPUT).absolute()
        return fly_request(
            Request(mission, directory.name, values, instance, 0, output, slot, check), limit_s
        )


def _failure(flown: Flown) -> Verdict:
    failure = flown.result.failure
    if failure is None:
        return Verdict(
            "a failure",
            "warning",
            'the mission does not heed "check": "fail" in its request: failures are untried',
        )
    if failure.of == "machine":
        return Verdict(
            "a failure",
            "failed",
            f"asked for a failure of the configuration it left none: {failure.reason}: {failure.message}",
        )
    return Verdict("a failure", "ok", f"reported as the configuration's: {failure.reason}")


def _time_out(mission: MissionFile, flown: Flown, limit_s: float) -> Verdict:
    took_s = flown.ended.wall_s
    if not flown.ended.timed_out and took_s < _TOO_SHORT_S:
        return Verdict(
            "a time-out", "ok", f"not tried: a mission of {took_s:.2f} s is over before it is stopped"
        )
    if not flown.ended.timed_out:
        return Verdict("a time-out", "warning", f"it ended in {took_s:.2f} s, before it could be stopped")
    late_s = took_s - limit_s
    if late_s > mission.stop_grace_s:
        return Verdict(
            "a time-out",
            "warning",
            f"ignores SIGTERM: killed {late_s:.1f} s after its limit of {limit_s:.2f} s",
        )
    return Verdict("a time-out", "ok", f"ended {late_s:.2f} s after its limit of {limit_s:.2f} s")


def _clean_up(flown: list[MissionResult], stopped: Flown) -> Verdict:
    if left := stopped.ended.survived:
        return Verdict("clean-up", "failed", f"{left} processes could not be ended")
    notes = [result.message for result in flown if result.reason == UNTIDY]
    if notes:
        return Verdict("clean-up", "warning", f"nothing is left now, but {notes[0]}")
    others = stopped.ended.left_behind
    return Verdict("clean-up", "ok", f"no process is left{f', {others} more were stopped' if others else ''}")
