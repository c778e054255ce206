"""Commands that misbehave: nothing is left behind, nothing hangs, nothing fills the disk."""

import os
import signal
import sys
import time
from pathlib import Path

import pytest

from nbv.errors import UserError
from tuner.missions.external.process import marked, run_command


def run(tmp_path, code, *, limit_s=10.0, mark=None, **options):
    return run_command(
        [sys.executable, "-c", code],
        tmp_path,
        {"PORT": "14541"},
        mark or str(tmp_path / "m"),
        tmp_path / "log",
        limit_s,
        options.pop("stop_grace_s", 0.3),
        **options,
    )


def test_a_command_gets_its_environment_and_its_log(tmp_path):
    ended = run(tmp_path, "import os; print('port', os.environ['PORT'])")
    assert (ended.status, ended.timed_out, ended.left_behind) == (0, False, 0)
    assert (tmp_path / "log").read_text() == "port 14541\n"


def test_the_status_is_the_commands_own(tmp_path):
    assert run(tmp_path, "raise SystemExit(7)").status == 7
    assert run(tmp_path, "import os; os.abort()").status == -signal.SIGABRT


def test_a_command_that_does_not_exist_is_one_line(tmp_path):
    with pytest.raises(UserError, match="cannot run 'no-such-program'"):
        run_command(["no-such-program"], tmp_path, {}, "m", tmp_path / "log", 5.0)


def test_a_time_out_ends_one_that_ignores_sigterm(tmp_path):
    started = time.monotonic()
    code = "import signal, time; signal.signal(signal.SIGTERM, signal.SIG_IGN); time.sleep(60)"
    ended = run(tmp_path, code, limit_s=0.5)
    assert ended.timed_out and ended.status == -signal.SIGKILL
    assert time.monotonic() - started < 5


CHILD = (
    "import os, subprocess, sys; "
    "subprocess.Popen([sys.executable, '-c', 'import time; time.sleep(60)'], start_new_session=True); "
    "print('done', flush=True)"
)


def test_children_in_sessions_of_their_own_are_ended(tmp_path):
    mark = str(tmp_path / "kept-alive")
    started = time.monotonic()
    ended = run(tmp_path, CHILD, mark=mark)
    assert ended.status == 0 and ended.left_behind == 1 and not ended.timed_out
    assert not marked(mark) and time.monotonic() - started < 5


def test_what_an_earlier_attempt_left_is_ended_first(tmp_path):
    mark = str(tmp_path / "again")
    pid = os.spawnvpe(
        os.P_NOWAIT, sys.executable, [sys.executable, "-c", "import time; time.sleep(60)"],
        {**os.environ, "GATETUNE_MISSION": mark},
    )  # fmt: off
    deadline = time.monotonic() + 5
    while not marked(mark) and time.monotonic() < deadline:
        time.sleep(0.02)
    run(tmp_path, "pass", mark=mark)
    assert os.waitpid(pid, 0)[1] & 0x7F == signal.SIGTERM


def test_a_flood_of_output_is_cut(tmp_path):
    ended = run(tmp_path, "print('x' * 3_000_000)", log_limit_bytes=10_000)
    assert ended.status == 0
    assert 10_000 <= (tmp_path / "log").stat().st_size < 10_200


def test_a_question_for_a_password_ends_at_once(tmp_path):
    ended = run(tmp_path, "import getpass; getpass.getpass()")
    assert ended.status != 0 and not ended.timed_out


def test_a_stopped_process_is_ended(tmp_path):
    ended = run(tmp_path, "import os, signal; os.kill(os.getpid(), signal.SIGSTOP)", limit_s=0.5)
    assert ended.timed_out and ended.status == -signal.SIGTERM


# A daemon without the environment that it was started in, in a session of its own, whose parents have ended.
DAEMON = (
    "import os, subprocess, sys; "
    "code = 'import os, time; os.setsid(); os.fork() and os._exit(0); "
    "open(\\'pid\\', \\'w\\').write(str(os.getpid())); time.sleep(60)'; "
    "subprocess.run(['env', '-i', sys.executable, '-S', '-c', code])"
)


def test_a_daemon_without_the_environment_is_ended(tmp_path):
    ended = run(tmp_path, DAEMON + "; import time; time.sleep(0.3)")
    assert ended.status == 0 and ended.left_behind == 1
    assert not _is_running(int((tmp_path / "pid").read_text()))


def test_a_daemon_is_ended_where_the_mission_kills_its_keeper(tmp_path):
    code = DAEMON + "; import time; time.sleep(0.3); os.kill(os.getppid(), 9); time.sleep(60)"
    assert run(tmp_path, code).status == -signal.SIGKILL
    assert not _is_running(int((tmp_path / "pid").read_text()))


def _is_running(pid):
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] not in ("Z", "X")
    except FileNotFoundError:
        return False
