"""The command, as a script and a person at a terminal meet it."""

from __future__ import annotations

import re
from typing import NamedTuple

import pytest

from driftplan.report.cli import main


class Printed(NamedTuple):
    """Exit code, stdout, stderr."""

    code: int
    out: str
    err: str


@pytest.fixture
def run(capsys):
    """Runs the command; gives what it `Printed`."""

    def run(*words):
        try:
            code = main([str(word) for word in words])
        except SystemExit as stop:
            code = stop.code
        printed = capsys.readouterr()
        return Printed(code, printed.out, printed.err)

    return run


@pytest.fixture
def refused(run):
    """Runs the command and expects exit code 2, nothing on stdout and one line that says what is wrong."""

    def refused(*words, match, code=2):
        got, out, err = run(*words)
        assert got == code, err
        assert out == ""
        assert "Traceback" not in err
        last = err.splitlines()[-1]
        assert re.search(match, last), last
        assert last.startswith("driftplan")

    return refused
