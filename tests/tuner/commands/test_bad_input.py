"""Missions and files that misbehave, from the command line: one clear line each, nothing lost, no process left."""

import re

import psutil
import pytest
import yaml

from tuner.campaign import Campaign

# What each instance does, in shell; after it the result is written as it should be.
WAYS = {
    "fine": "",
    "nothing": "exit 0",
    "half": """printf '{"schema": "gatetune.res' > "$GATETUNE_RESULT"; exit""",
    "nan": "GAIN=NaN",
    "newer": "SCHEMA=2",
    "password": "read -r secret < /dev/tty || exit 1",
    "crash": "echo 'no licence found' >&2; kill -SEGV $$",
    "children": "setsid sleep 86399 &",
    "floods": "yes | head -c 20000000",
    "stubborn": "trap '' TERM; sleep 86399; sleep 86399",
}
LOST = {  # the machine's: said in a line, kept, flown again by a resume
    "nothing": "no result.json; ended with status 0; see",
    "half": "result.json is not valid JSON",
    "nan": "result.json holds NaN",
    "newer": "result.json has schema gatetune.result/2; this version reads",
    "password": "no result.json; ended with status 1: 'fly.sh: ",
    "crash": "no result.json; ended by SIGSEGV: 'no licence found'",
}
FLY = """GAIN=$PARAMETER_gain SCHEMA=1
case $GATETUNE_INSTANCE in
{ways}
esac
printf '{{"schema": "gatetune.result/%s", "status": "ok", "metrics": {{"loss": %s}}}}' $SCHEMA $GAIN > "$GATETUNE_RESULT"
"""
FILE = {
    "schema": "gatetune.mission/1",
    "name": "bad",
    "command": ["sh", "fly.sh"],
    "parameters": {"gain": {"kind": "float", "low": 0, "high": 4, "default": 1}},
    "instances": list(WAYS),
    "metric": "loss",
    "direction": "minimise",
    "time_limit_s": 3,
    "stop_grace_s": 0.1,
    "retries": 0,
}
RUN = ["campaign", "run", "--mission", "bad.yaml", "--sampler", "sobol", "--workers", 1]


def write(folder, ways=WAYS, **changes):
    cases = "\n".join(f"  {name}) {way}\n  ;;" for name, way in ways.items() if way)
    (folder / "fly.sh").write_text(FLY.format(ways=cases))
    (folder / "bad.yaml").write_text(yaml.safe_dump({**FILE, **changes}))


def left_behind(folder):
    """Processes that a mission of this folder started."""
    marked = []
    for process in psutil.process_iter():
        try:
            if process.environ().get("GATETUNE_MISSION", "").startswith(str(folder)):
                marked.append(process)
        except psutil.Error:
            continue
    return marked


@pytest.mark.slow
def test_what_misbehaves_costs_a_campaign_nothing_else(gatetune, tmp_path):
    write(tmp_path)
    code, out, err = gatetune(*RUN, "--budget", len(WAYS))
    assert code == 1 and "Traceback" not in out + err
    lines = {line.split()[1]: line for line in out.splitlines() if re.match(r"#\d+ ", line)}
    said = {
        name: line.partition(" lost: ")[2].rstrip("…") for name, line in lines.items() if " lost: " in line
    }
    assert said.keys() == LOST.keys()
    assert all(line.startswith(LOST[name]) or LOST[name].startswith(line) for name, line in said.items())
    assert not left_behind(tmp_path)
    campaign = Campaign.open(tmp_path / "runs/bad", read_only=True)
    before = campaign.trials()
    assert {t.rock for t in before if t.state == "running"} == set(LOST)
    assert {t.rock: t.reason for t in before if t.state == "failed"} == {"stubborn": "timeout"}
    assert {t.rock: t.status for t in before if t.state == "complete"} == {
        "fine": "ok",
        "floods": "ok",
        "children": "degraded",
    }
    [log] = (tmp_path / "runs/bad/missions").glob("*_floods_*/output/mission.log")
    assert log.stat().st_size < 6_000_000
    write(tmp_path, {})  # mended
    code, out, err = gatetune("campaign", "resume", "runs/bad", "--accept-changes")
    assert code == 0, out + err
    after = Campaign.open(tmp_path / "runs/bad", read_only=True).trials()
    assert [t.values for t in after] == [t.values for t in before]
    assert [t.rock for t in after if t.state != "complete"] == ["stubborn"]


PORTS = {"A": {"kind": "port", "first": 5000}, "B": {"kind": "port", "first": 5000}}


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"command": ["no-such-program"]}, "cannot run 'no-such-program'"),
        ({"resources": PORTS}, "port 5000 would belong to A of slot 0 and to B of slot 0"),
        ({"schema": "gatetune.mission/2"}, "upgrade gatetune or the mission"),
    ],
)
def test_what_no_mission_can_mend_stops_at_once(gatetune, tmp_path, changes, says):
    write(tmp_path, {}, **changes)
    code, _, err = gatetune(*RUN, "--budget", 3)
    assert code == 2 and says in err and err.count("\n") == 1 and not left_behind(tmp_path)
