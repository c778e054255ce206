"""The contract tried before a night is spent on it: each part with a verdict."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Literal, NamedTuple

from nbv.errors import MissionFailure
from nbv.mission.result import MissionResult
from tuner.missions.external.configuration import external_config
from tuner.missions.external.contract import Request
from tuner.missions.external.flight import (
    HARDLY_OVERLAP,
    OUTPUT,
    UNTIDY,
    Flown,
    fly_request,
    run_external_mission,
)
from tuner.missions.external.mission_file import MissionFile
from tuner.missions.external.slots import slots_of, take_slot
from tuner.problem.objective import dotted

_WAIT_S = 5.0
_SHARE_OF_WALL = 0.3  # of a mission's time, after which the rehearsal stops one
_SHORTEST_S = 0.02
_TIME_OUTS = 4
_TOO_SHORT_S = 0.25  # a few times as long as it takes to start a process and to look at it


class Verdict(NamedTuple):
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
    tuned, held_out = len(mission.instances), len(mission.held_out)
    found = f"{mission.space.dimension} parameters, {tuned} instances to tune on, {held_out} held out"
    yield Verdict("mission file", "ok", found)
    flown: list[MissionResult] = []
    for part in ("the default", "the same again"):
        try:
            result = run_external_mission(
                external_config(mission),
                mission.instances[0].name,
                0,
                folder / part.replace(" ", "-"),
                keep="all",
            )
        except MissionFailure as failure:
            yield Verdict(part, "failed", f"{failure.reason}: {failure.message}")
            return
        flown.append(result)
        verdict = _of_default(mission, part, flown)
        yield verdict
        if verdict.kind == "failed":
            return
    yield _of_failure(_fly(mission, folder / "failure", check="fail"))
    limit_s = max(_SHORTEST_S, _SHARE_OF_WALL * flown[0].costs["wall_s"])
    for attempt in range(_TIME_OUTS):
        stopped = _fly(mission, folder / f"time-out-{attempt}", limit_s=limit_s)
        if stopped.ended.timed_out or attempt == _TIME_OUTS - 1:
            break
        # The default may have been flown on a busier machine than this one: a shorter limit then.
        limit_s = _SHARE_OF_WALL * stopped.ended.wall_s
    yield _of_time_out(mission, stopped, limit_s)
    yield _of_end(flown, stopped)


def _of_default(mission: MissionFile, part: str, flown: list[MissionResult]) -> Verdict:
    result, metric = flown[-1], mission.objective.metric
    if result.status == "failed":
        said = f"the default configuration failed: {result.reason} {result.message}".rstrip()
        return Verdict(part, "failed", said)
    first, value = (mission.objective.measure(each.metrics) for each in (flown[0], result))
    if value is None or first is None:
        there = ", ".join(dotted(result.metrics)) or "none"
        return Verdict(part, "failed", f"no metric {metric!r}; there are {there}")
    text = f"{metric} = {value:.6g} on {result.rock!r} in {result.costs['wall_s']:.2f} s"
    if result.reason == HARDLY_OVERLAP:
        return Verdict(part, "warning", f"{text}, but {result.message}")
    if len(flown) == 1:
        return Verdict(part, "ok", text)
    if value == first:
        return Verdict(part, "ok", f"{text}: the same number, it repeats exactly")
    off = abs(value - first)
    text += f": differs by {off:.3g} ({100 * off / max(abs(first), 1e-300):.2g} %) at the same seed"
    if mission.replicates > 1:
        return Verdict(part, "ok", text)
    return Verdict(part, "warning", f"{text}; replicates: 2 or more would average it")


def _fly(mission: MissionFile, directory: Path, *, check: str = "", limit_s: float | None = None) -> Flown:
    with take_slot(mission, slots_of(mission), _WAIT_S) as slot:
        values, instance = external_config(mission).values, mission.instances[0].name
        output = (directory / OUTPUT).absolute()
        return fly_request(
            Request(mission, directory.name, values, instance, 0, output, slot, check), limit_s
        )


def _of_failure(flown: Flown) -> Verdict:
    part, failure = "a failure", flown.result.failure
    if failure is None:
        return Verdict(
            part, "warning", 'the mission does not heed "check": "fail" in its request: failures are untried'
        )
    if failure.of == "machine":
        said = f"{failure.reason}: {failure.message}"
        return Verdict(part, "failed", f"asked for a failure of the configuration it left none: {said}")
    return Verdict(part, "ok", f"reported as the configuration's: {failure.reason}")


def _of_time_out(mission: MissionFile, flown: Flown, limit_s: float) -> Verdict:
    part, took_s = "a time-out", flown.ended.wall_s
    if not flown.ended.timed_out:
        if took_s < _TOO_SHORT_S:
            return Verdict(part, "ok", f"not tried: a mission of {took_s:.2f} s is over before it is stopped")
        return Verdict(part, "warning", f"it ended in {took_s:.2f} s, before it could be stopped")
    late_s, limit = took_s - limit_s, f"after its limit of {limit_s:.2f} s"
    if late_s > mission.stop_grace_s:
        return Verdict(part, "warning", f"ignores SIGTERM: killed {late_s:.1f} s {limit}")
    return Verdict(part, "ok", f"ended {late_s:.2f} s {limit}")


def _of_end(flown: list[MissionResult], stopped: Flown) -> Verdict:
    part, others = "clean-up", stopped.ended.left_behind
    if left := stopped.ended.survived:
        return Verdict(part, "failed", f"{left} processes could not be ended")
    if notes := [result.message for result in flown if result.reason == UNTIDY]:
        return Verdict(part, "warning", f"nothing is left now, but {notes[0]}")
    return Verdict(part, "ok", f"no process is left{f', {others} more were stopped' if others else ''}")
