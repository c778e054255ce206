import pytest

from tuner.cli import main
from tuner.commands import console


@pytest.fixture
def gatetune(monkeypatch, capfd, tmp_path):
    """Run the command in an empty working directory; returns (exit code, stdout, stderr).

    ``gatetune.ok`` returns stdout of what must end well, ``gatetune.refused`` the one line of a user's mistake.
    """
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "200")
    # A console reads COLUMNS once, when it is made: whichever test imports it first would decide.
    for shared in (console.output, console.errors):
        monkeypatch.setattr(shared, "width", 200)

    def run(*arguments):
        monkeypatch.setattr("sys.argv", ["gatetune", *map(str, arguments)])
        try:
            main()
            code = 0
        except SystemExit as stop:
            code = stop.code or 0
        out, err = capfd.readouterr()
        return code, out, err

    def ok(*arguments):
        code, out, err = run(*arguments)
        assert code == 0, (arguments, out, err)
        return out

    def refused(*arguments):
        code, _, err = run(*arguments)
        assert code == 2 and err.startswith("error:") and err.count("\n") == 1, (arguments, code, err)
        return err

    run.ok, run.refused = ok, refused
    return run
