"""Run directories that somebody else made: an archive or a clone keeps links, a disk flips bits, names hold what steers a terminal."""

import errno
import json
import os
import resource
import shutil
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import fake_campaigns
import numpy as np
import pytest
from in_process import InProcessExecutor

from nbv.cache import Store
from nbv.checksums import CHECKSUM
from nbv.config import MissionConfig
from nbv.errors import UserError
from nbv.mission.run_directory import RunDirectory
from nbv.safe_files import open_to_write, remove_links, require_whole, write_atomic
from tuner.campaign.campaign import Campaign
from tuner.campaign.session import run_campaign
from tuner.commands.console import output, show_table
from tuner.comparison.plan import EvaluationPlan
from tuner.comparison.run import run_evaluation
from tuner.missions.job import MissionJob
from tuner.missions.long_runs import exclusive
from tuner.missions.pool import _reason

FIDELITY = fake_campaigns.FIDELITY
FIRST = "missions/0000_a_r0"
COMMANDS = {
    "status": "campaign status DIR",
    "list": "campaign list DIR/..",
    "resume": "campaign resume DIR --missions 4",
    "evaluate": "evaluate DIR --rock nobodys",
    "confirm": "confirm DIR --rock nobodys",
    "export": "export DIR",
    "export missions": "export DIR --to csv",
    "export route": "export DIR --to plan --home 46,7",
    "export evaluation": "export DIR/evaluation --to csv",
    "view": "mission view DIR",
    "view a mission": f"mission view DIR/{FIRST}",
    "explain": f"mission explain DIR/{FIRST}",
}
ABSENT = ("study.journal.torn", "missions.csv", "view.html", "shown", "confirmation")


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A finished campaign with an evaluation in it."""
    directory = tmp_path_factory.mktemp("theirs") / "run"
    fake_campaigns.run(directory, sampler="sobol", budget=3)
    (directory / "report.html").touch()
    (directory / FIRST / "config.yaml").touch()
    plan = EvaluationPlan({"default": MissionConfig()}, ("a",), fidelity=FIDELITY)
    run_evaluation(plan, directory / "evaluation", InProcessExecutor())
    return directory


def content(folder: Path) -> dict[str, bytes | None]:
    return {str(p.relative_to(folder)): p.read_bytes() if p.is_file() else None for p in folder.rglob("*")}


@pytest.mark.parametrize("command", COMMANDS)
def test_every_name_a_link_in_turn(
    command: str, made: Path, tmp_path: Path, gatetune: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("tuner.commands.campaign.executor_at", lambda *_: InProcessExecutor())
    monkeypatch.setattr("tuner.commands.campaign.write_pages", lambda *_: None)
    monkeypatch.setattr("tuner.recommendation.choose.recommend", lambda *_, **__: None)
    outside = shutil.copytree(made, tmp_path / "outside")
    for absent in ABSENT[:3]:
        (outside / absent).write_text("outside\n")
    before = content(outside)
    names = [n for n in content(made) if not n.startswith(("missions/0001", "missions/0002"))]
    for name in (*names, *ABSENT):
        run = shutil.copytree(made, tmp_path / "theirs" / "run")
        with (run / "study.journal").open("a") as journal:
            journal.write("touch owned\n{")  # as the exploit had it; also the torn end of a killed process
        place = run / name
        shutil.rmtree(place) if place.is_dir() else place.unlink(missing_ok=True)
        place.symlink_to(outside / name)
        code, _, err = gatetune(*COMMANDS[command].replace("DIR", str(run)).split())
        assert content(outside) == before, name
        assert code in (0, 2) and err.count("\n") == (code != 0), (name, code, err)
        shutil.rmtree(run)


@pytest.mark.parametrize("kind", ["link", "pipe", "hard link"])
def test_what_is_written_goes_nowhere_else(kind: str, tmp_path: Path) -> None:
    """And nothing waits for the other end of a pipe."""
    outside, run = tmp_path / "outside", tmp_path / "run"
    outside.write_text("outside")
    run.mkdir()

    def put(path: Path) -> Path:
        path.parent.mkdir(exist_ok=True)
        path.unlink(missing_ok=True)
        if kind == "pipe":
            os.mkfifo(path)
        else:
            (path.symlink_to if kind == "link" else path.hardlink_to)(outside)
        return path

    write_atomic(put(run / "page"), "ours")
    assert (run / "page").read_text() == "ours"
    for how in (os.O_EXCL, os.O_APPEND, 0)[: 1 if kind == "hard link" else 3]:
        with pytest.raises((UserError, FileExistsError)):
            open_to_write(put(run / "file"), how)
    if kind == "hard link":
        with exclusive(put(run / "run.lock").parent):
            pass
    else:
        with pytest.raises(UserError, match=f"run.lock is {'a link' if kind == 'link' else 'neither'}"):
            exclusive(put(run / "run.lock").parent).__enter__()
    for name in ("trace.jsonl", "mission.json", "dense.ply", "images", "states", "sparse"):
        put(run / name)
    mission = RunDirectory(run, overwrite=True)
    mission.append("trace.jsonl", "{}")
    put(run / "images" / "a.png")
    mission.write_image("a.png", np.zeros((2, 2, 3), "uint8"))
    put(run / "missions" / "worker.log")
    remove_links(run / "missions")
    assert not list((run / "missions").iterdir())
    assert outside.read_text() == "outside"


def test_a_mission_flies_where_its_number_says(made: Path, tmp_path: Path) -> None:
    """Whatever the ledger calls its directory or rock; its checksum has no key."""
    run = Path(shutil.copytree(made, tmp_path / "run"))
    ledger = Campaign.open(run).ledger
    params = dict(ledger.trials()[2].values)
    outside = str(tmp_path / "outside")
    for name, value in (("directory", "../../outside"), ("directory", outside), ("rock", "../x")):
        records = [json.loads(line) for line in (made / "study.journal").read_text().splitlines()]
        last = max(k for k, record in enumerate(records) if record["op_code"] == 4)
        entry = {**records[last]["user_attrs"], name: value}
        entry[CHECKSUM] = ledger._checksum(2, params, entry)
        records[last]["user_attrs"] = entry
        (run / "study.journal").write_text("".join(json.dumps(r) + "\n" for r in records[: last + 1]))
        if name == "rock":
            with pytest.raises(UserError, match=r"trial 2 of the ledger .* is not what was entered"):
                Campaign.open(run)
            continue
        campaign = Campaign.open(run)
        assert campaign.trials()[2].record.directory.parent == run / "missions"
        run_campaign(campaign, InProcessExecutor())
        assert not (tmp_path / "outside").exists()


def test_a_flipped_bit_at_the_ledgers_end_is_healed_or_refused_before_writing(
    made: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A resume that opens it leaves it readable."""
    run = Path(shutil.copytree(made, tmp_path / "run"))
    sound = (run / "study.journal").read_bytes()
    begin = sound.rfind(b"\n", 0, -1) + 1
    monkeypatch.setattr("tuner.recommendation.choose.recommend", lambda *_, **__: None)
    healed = 0
    for bit in range(0, 8 * (len(sound) - begin), 31):
        flipped = bytearray(sound)
        flipped[begin + bit // 8] ^= 1 << bit % 8
        (run / "study.journal").write_bytes(flipped)
        try:
            campaign = Campaign.open(run)
        except UserError:
            assert (run / "study.journal").read_bytes() == flipped, bit
            continue
        run_campaign(campaign, InProcessExecutor())
        assert Campaign.open(run, read_only=True).status().finished == 3, bit
        healed += 1
    assert healed > 5


@pytest.mark.parametrize("number", [errno.EFBIG, errno.ENOSPC])
def test_a_limit_of_the_machine_is_not_the_configurations_fault(number: int, tmp_path: Path) -> None:
    reason, message = _reason(OSError(number, os.strerror(number)))
    assert MissionJob("0", MissionConfig(), "a", 0, tmp_path).failed(reason, message).infrastructure_failure


def test_a_file_that_a_compiled_library_could_not_end_is_noticed(tmp_path: Path) -> None:
    path, limits = tmp_path / "points3D.bin", resource.getrlimit(resource.RLIMIT_FSIZE)
    path.write_bytes(bytes(8192))
    require_whole(path)
    assert path.stat().st_size == 8192
    resource.setrlimit(resource.RLIMIT_FSIZE, (8192, limits[1]))
    try:
        with pytest.raises(OSError, match="File too large"):
            require_whole(path)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)


def test_ctrl_c_while_it_loads_shows_no_traceback(tmp_path: Path) -> None:
    (tmp_path / "typer.py").write_text("import time; print('loading', flush=True); time.sleep(60)")
    path = os.pathsep.join([str(tmp_path), *filter(None, sys.path)])
    command = subprocess.Popen(
        [sys.executable, "-m", "tuner.cli", "doctor"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "PYTHONPATH": path},
    )
    assert command.stdout is not None and command.stdout.readline() == "loading\n"
    command.send_signal(signal.SIGINT)
    assert command.communicate(timeout=60) == ("", "") and command.returncode == -signal.SIGINT


def test_nothing_steers_the_terminal_or_the_page(gatetune: Any, tmp_path: Path) -> None:
    evil = "a\x1b]0;owned\x07\x1b[2J\x9b\u202eb"
    run = tmp_path / "run"
    fake_campaigns.run(run, sampler="sobol", budget=2, name=evil)
    for command in ("campaign status", "campaign list", "export", "mission view"):
        code, out, err = gatetune(*command.split(), run.parent if command.endswith("list") else run)
        assert code == 0 and not set("\x1b\x07\x9b\u202e") & set(out + err), command
    show_table((evil,), [(evil,)], evil)
    output.print(evil)
    assert not set("\x1b\x07\x9b\u202e") & set((run / "report.html").read_text())


def test_a_store_keeps_its_size_whoever_puts(tmp_path: Path) -> None:
    for number in range(60):
        Store(tmp_path, 200_000).put("kind", f"{number:04d}", {"a": np.zeros(20_000, np.uint8)})
    assert 100_000 < sum(kind.size_bytes for kind in Store(tmp_path).info()) <= 200_000
