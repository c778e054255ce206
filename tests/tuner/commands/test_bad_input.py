"""Missions and files that misbehave, from the command line: one clear line each, nothing lost, no process left."""

import re

import psutil
import pytest
import yaml

from tuner.campaign.campaign import Campaign

# What each instance does, in shell; after it the result is written as it should be.
WAYS = {
    "fine": "",
    "nothing": "exit 0",
    "half": """printf '{"metrics": {"lo' > "$GATETUNE_OUTPUT/result.json"; exit""",
    "nan": "GAIN=NaN",
    "password": "read -r secret < /dev/tty || exit 1",
    "crash": "echo 'no licence found' >&2; kill -SEGV $$",
    "children": "setsid sleep 86399 &",
    "stubborn": "trap '' TERM; sleep 86399; sleep 86399",
}
LOST = {  # the machine's: said in a line, kept, run again by a resume
    "nothing": "no result.json; it ended with status 0; see",
    "half": "result.json is not valid JSON",
    "password": "no result.json; it ended with status 1: 'run.sh: ",
    "crash": "no result.json; it ended with SIGSEGV: 'no licence found'",
}
SCRIPT = """GAIN=$PARAMETER_gain
case $GATETUNE_INSTANCE in
{ways}
esac
printf '{{"metrics": {{"loss": %s}}}}' $GAIN > "$GATETUNE_OUTPUT/result.json"
"""
FILE = {
    "name": "bad",
    "command": ["sh", "run.sh"],
    "parameters": {"gain": {"kind": "float", "low": 0, "high": 4, "default": 1}},
    "instances": list(WAYS),
    "metric": "loss",
    "direction": "minimise",
    "time_limit_s": 2,
}
RUN = ["campaign", "run", "--mission", "bad.yaml", "--sampler", "sobol", "--workers", 1]


def write(folder, ways=WAYS, **changes):
    cases = "\n".join(f"  {name}) {way}\n  ;;" for name, way in ways.items() if way)
    (folder / "run.sh").write_text(SCRIPT.format(ways=cases))
    (folder / "bad.yaml").write_text(yaml.safe_dump({**FILE, **changes}))


def left_behind(folder):
    """Processes that a mission of this folder started."""
    marked = []
    for process in psutil.process_iter():
        try:
            if process.environ().get("GATETUNE_OUTPUT", "").startswith(str(folder)):
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
    assert {t.rock: t.reason for t in before if t.state == "failed"} == {
        "stubborn": "timeout",
        "nan": "metric_not_a_number",
    }
    assert {t.rock: t.record.status for t in before if t.state == "complete"} == {
        "fine": "ok",
        "children": "ok",
    }
    write(tmp_path, {})  # mended
    code, out, err = gatetune("campaign", "resume", "runs/bad", "--accept-changes", "--mission", "bad.yaml")
    assert code == 0, out + err
    after = Campaign.open(tmp_path / "runs/bad", read_only=True).trials()
    assert [t.values for t in after] == [t.values for t in before]
    assert [t.rock for t in after if t.state != "complete"] == ["nan", "stubborn"]


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"command": ["no-such-program"]}, "cannot run 'no-such-program'"),
        ({"resources": {}}, "unknown key 'resources'"),
    ],
)
def test_what_no_mission_can_mend_stops_at_once(gatetune, tmp_path, changes, says):
    write(tmp_path, {}, **changes)
    code, _, err = gatetune(*RUN, "--budget", 3)
    assert code == 2 and says in err and err.count("\n") == 1 and not left_behind(tmp_path)
