"""The command ``gatetune``: three jobs (campaign, evaluate, reproduce) and what they are made of."""

from __future__ import annotations

import contextlib
import errno
import io
import signal
import sys
import traceback
from importlib import metadata
from typing import Annotated

from nbv.process import single_thread_environment

single_thread_environment()  # before anything imports numpy: one mission, one thread

import typer  # noqa: E402
from rich.text import Text  # noqa: E402

from nbv import plugins  # noqa: E402
from nbv.cache import home  # noqa: E402
from nbv.errors import UserError  # noqa: E402
from tuner.commands import (  # noqa: E402
    campaign,
    compare,
    config,
    doctor,
    evaluate,
    export,
    mission,
    photographs,
    plugin,
    rocks,
)
from tuner.commands.console import errors, only_json, output  # noqa: E402

EXIT_UNEXPECTED = 70  # EX_SOFTWARE
# Parts of the messages of the system, PyTorch, the loader, C++ and Python.
_NO_MEMORY = (
    *("annot allocate memory", "can't allocate memory", "failed to map segment", "std::bad_alloc"),
    "can't start new thread",
    "error return without exception set",  # CPython, where an allocation fails in a function of C
)

app = typer.Typer(
    name="gatetune",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    add_completion=True,
)


def _print_version(wanted: bool) -> None:
    if wanted:
        output.print(f"gatetune {metadata.version('gatetune')}", highlight=False)
        raise typer.Exit


@app.callback()
def options(
    version: Annotated[
        bool, typer.Option("--version", is_eager=True, callback=_print_version, help="Print the version.")
    ] = False,
    plugin: Annotated[
        list[str] | None,
        typer.Option(
            help="Module or file that registers plug-ins, named again to resume or view what uses them; repeatable."
        ),
    ] = None,
) -> None:
    """Tune hybrid next-best-view planning with Bayesian optimisation on simulated photogrammetry missions."""
    only_json(False)
    for spec in plugin or []:
        plugins.use(spec)


app.add_typer(campaign.app, name="campaign", help="Job 1: run, resume and inspect tuning campaigns.")
for command in (
    evaluate.evaluate,
    compare.compare,
    evaluate.confirm,
    evaluate.reproduce,
    export.export,
    doctor.doctor,
):
    app.command()(command)
app.add_typer(mission.app, name="mission", help="Run one mission, explain its decisions, view it in 3D.")
app.add_typer(rocks.app, name="rocks", help="List, show and import rocks.")
app.add_typer(
    photographs.app, name="photographs", help="Import sets of real photographs; find how few are enough."
)
app.add_typer(plugin.app, name="plugin", help="List the plug-ins of other packages; write one of your own.")
app.add_typer(config.app, name="config", help="Print a preset's complete configuration.")


def main() -> None:
    """Entry point: a mistake is one line, never a traceback; a user's has exit code 2, one of the program 70.

    The traceback of an unexpected error is kept in ``last_error.log`` of the user's folder (``GATETUNE_HOME``).
    """
    ends_at_once = signal.getsignal(signal.SIGINT) is signal.SIG_DFL  # see `tuner`
    if ends_at_once:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")  # a file's name may hold anything
    try:
        for argument in sys.argv[1:]:
            if any("\ud800" <= c <= "\udfff" for c in argument):
                raise UserError(f"the argument {argument!a} is not UTF-8; rename what it names")
        app()
    except UserError as error:
        _say(str(error))
        sys.exit(2)
    except KeyboardInterrupt:
        errors.print("interrupted")
        sys.exit(130)
    except SystemExit as ended:
        if isinstance(getattr(ended.__context__, "__cause__", None), KeyboardInterrupt):  # typer says nothing
            errors.print("interrupted")
        raise
    except Exception as error:
        if isinstance(error, OSError) and error.filename is not None:
            _say(f"{error.strerror}: {error.filename}")
            sys.exit(2)
        if isinstance(error, OSError) and error.errno in (errno.ENOSPC, errno.EDQUOT):
            _say(
                "the disk is full; free some space, then give the same command again: finished missions are kept"
            )
            sys.exit(2)
        if isinstance(error, MemoryError) or any(said in str(error) for said in _NO_MEMORY):
            _say("memory ran out; free some or use fewer workers, then resume: finished missions are kept")
            sys.exit(2)
        where = ""
        with contextlib.suppress(OSError, RuntimeError, UserError):
            log = home() / "last_error.log"
            log.parent.mkdir(parents=True, exist_ok=True)
            log.write_text(f"{sys.argv}\n{traceback.format_exc()}", errors="backslashreplace")
            where = f"; the details are in {log}"
        _say(f"unexpected {type(error).__name__}: {error}{where}")
        sys.exit(EXIT_UNEXPECTED)
    finally:
        for line in plugins.left_out():
            _say(line, "note", "yellow")
        if ends_at_once:  # the interpreter takes itself down
            signal.signal(signal.SIGINT, signal.SIG_DFL)


def _say(message: str, kind: str = "error", color: str = "bold red") -> None:
    line = " ".join(message.split("\n"))
    errors.print(Text.assemble((f"{kind}:", color), " ", line), highlight=False, soft_wrap=True)


if __name__ == "__main__":
    main()
