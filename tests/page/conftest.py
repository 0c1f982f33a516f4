"""The page's own code, run by node where there is one."""

from __future__ import annotations

import json
import shutil
import subprocess
from pathlib import Path

import pytest


@pytest.fixture(scope="session")
def javascript():
    """A function that asks the page's code a question (tests/page/compute.mjs)."""
    node = shutil.which("node")
    if node is None:
        pytest.skip("no node on PATH to run the page's JavaScript with")
    script = Path(__file__).with_name("compute.mjs")
    process = subprocess.Popen([node, str(script)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)

    def ask(what, **question):
        process.stdin.write(json.dumps({"ask": what, **question}, allow_nan=False) + "\n")
        process.stdin.flush()
        answer = process.stdout.readline()
        assert answer, "the page's code failed: see the error above"
        return json.loads(answer)

    yield ask
    process.stdin.close()
    process.stdout.close()
    process.wait(timeout=10)
