"""Ledgers in a real PostgreSQL, which the test starts: several campaigns, one coordinator each, on whatever machine."""

from __future__ import annotations

import collections
import os
import shutil
import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest
from fake_campaigns import FIDELITY, settings
from in_process import InProcessExecutor
from optuna.storages import RDBStorage
from sqlalchemy.exc import OperationalError

from nbv.errors import UserError
from tuner.campaign import storage
from tuner.campaign.begin import begin_campaign, extend_campaign
from tuner.campaign.campaign import Campaign
from tuner.campaign.events import CampaignEvent
from tuner.campaign.session import run_campaign

pytest.importorskip("psycopg", reason="pip install 'gatetune[cluster]'")
PROGRAMS = sorted(Path("/usr/lib/postgresql").glob("*/bin")) or [
    Path(path).parent for path in [shutil.which("initdb")] if path
]
COORDINATOR = """
import os, signal, sys
from pathlib import Path
from tuner.campaign.campaign import Campaign
from tuner.campaign.session import run_campaign
from in_process import InProcessExecutor
def end(event):
    if event.kind == "finished" and event.finished == 3:
        os.kill(os.getpid(), signal.SIGKILL)
run_campaign(Campaign.open(Path(sys.argv[1]), fidelity="fake_missions:fake_mission"), InProcessExecutor(), end)
"""


class Server:
    """PostgreSQL on a socket in a folder of its own."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self.url = f"postgresql+psycopg://gatetune@/postgres?host={folder}"
        # It refuses to run as root.
        self._user = {"user": "nobody", "group": "nogroup"} if os.getuid() == 0 else {}
        if self._user:
            shutil.chown(folder, **self._user)
        self._run("initdb", "-D", "data", "-U", "gatetune", "--auth=trust", "--no-sync")

    def _run(self, program: str, *arguments: str) -> None:
        command = [str(PROGRAMS[-1] / program), *arguments]
        subprocess.run(command, cwd=self._folder, check=True, stdout=subprocess.DEVNULL, **self._user)  # type: ignore[call-overload]

    def start(self) -> None:
        options = f"-c listen_addresses= -c unix_socket_directories={self._folder} -c fsync=off"
        self._run("pg_ctl", "-D", "data", "-w", "-l", "log", "-o", options, "start")

    def end_connections(self) -> None:
        """As a network that fails does."""
        query = "select pg_terminate_backend(pid) from pg_stat_activity where pid <> pg_backend_pid()"
        self._run("psql", "-q", "-h", str(self._folder), "-U", "gatetune", "postgres", "-c", query)

    def stop(self) -> None:
        self._run("pg_ctl", "-D", "data", "-m", "immediate", "stop")


@pytest.fixture(scope="module")
def server() -> Iterator[Server]:
    if not PROGRAMS:
        pytest.skip("PostgreSQL is absent: apt-get install postgresql")
    folder = Path(tempfile.mkdtemp(prefix="pg"))
    found = Server(folder)
    found.start()
    yield found
    subprocess.run(
        ["pkill", "-F", str(folder / "data/postmaster.pid")], check=False, stderr=subprocess.DEVNULL
    )
    shutil.rmtree(folder, ignore_errors=True)


def test_a_coordinator_that_dies_is_replaced_elsewhere(tmp_path: Path, server: Server) -> None:
    url = server.url
    mine = begin_campaign(tmp_path / "here/night", settings(name="night", storage=url, sampler="sobol"))
    other = begin_campaign(tmp_path / "here/other", settings(name="other", storage=url, sampler="sobol"))
    elsewhere = shutil.copytree(mine.directory, tmp_path / "elsewhere/night")  # another machine has a copy
    script = [sys.executable, "-c", COORDINATOR, str(mine.directory)]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    assert subprocess.run(script, env=environment, timeout=60).returncode == -signal.SIGKILL
    second = Campaign.open(elsewhere, fidelity=FIDELITY)
    assert (
        run_campaign(other, InProcessExecutor()).stopped == "budget"
    )  # a campaign of its own in the same database
    with mine.ledger.exclusive(), pytest.raises(UserError, match="being run on"):
        run_campaign(second, InProcessExecutor())
    assert run_campaign(second, InProcessExecutor()).stopped == "budget"
    trials = second.trials()
    assert [t.state for t in trials] == ["complete"] * 9 and [t.number for t in trials] == list(range(9))
    evaluated = list(tmp_path.glob("*/night/missions/*/flown.txt"))
    assert len(evaluated) == 9  # three there, six here
    extend_campaign(Campaign.open(elsewhere, fidelity=FIDELITY), 12)
    assert Campaign.open(elsewhere, fidelity=FIDELITY).status().remaining == 3


def test_a_coordinator_that_was_cut_off_goes_on_unless_it_was_replaced(
    tmp_path: Path, server: Server
) -> None:
    url = server.url
    cut_off = begin_campaign(tmp_path / "cut", settings(name="cut", storage=url, sampler="sobol"))
    fresh = Campaign.open(shutil.copytree(cut_off.directory, tmp_path / "new"), fidelity=FIDELITY)

    def cut(event: CampaignEvent) -> None:
        if event.kind == "finished" and event.finished == 3:
            server.end_connections()

    with cut_off.ledger.exclusive():
        server.end_connections()
        assert run_campaign(fresh, InProcessExecutor(), cut).stopped == "budget"  # cut off, and nobody came
        with pytest.raises(UserError, match="another one has taken over"):
            cut_off.ledger.finish(0, None)  # type: ignore[arg-type]
    assert [t.state for t in fresh.trials()] == ["complete"] * 9


@pytest.mark.parametrize("answer_lost", [False, True])
def test_a_cut_connection_ends_no_campaign(
    answer_lost: bool, tmp_path: Path, server: Server, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Every kind of call fails twice, before or after it did its work."""
    cuts = collections.Counter[str]()

    def cut_twice(name: str) -> None:
        whole = getattr(RDBStorage, name)

        def call(self: RDBStorage, *arguments: object, **options: object) -> object:
            cuts[name] += 1
            if cuts[name] > 2:
                return whole(self, *arguments, **options)
            if answer_lost:
                whole(self, *arguments, **options)
            raise OperationalError("SELECT 1", {}, Exception("server closed the connection"))

        monkeypatch.setattr(RDBStorage, name, call)

    asked = settings(name=f"twice {answer_lost}", sampler="sobol", budget=3, storage=server.url)
    campaign = begin_campaign(tmp_path / "run", asked)
    for name in ("create_new_trial", "set_trial_user_attr", "set_trial_state_values", "get_trial"):
        cut_twice(name)
    monkeypatch.setattr(storage, "_FIRST_PAUSE_S", 0.001)
    summary = run_campaign(campaign, InProcessExecutor())
    assert summary.stopped == "budget" and min(cuts.values()) > 2
    monkeypatch.undo()
    again = Campaign.open(tmp_path / "run", fidelity=FIDELITY)
    assert [t.state for t in again.trials()] == ["complete"] * 3
    assert len(list(tmp_path.glob("run/missions/*/flown.txt"))) == 3
