"""What bash completes, asked of bash."""

from __future__ import annotations

import shutil
import subprocess

import pytest

from driftplan.report.cli import main
from driftplan.report.commands import COMMANDS

pytestmark = pytest.mark.skipif(shutil.which("bash") is None, reason="there is no bash")


def completed(script: str, folder: str, *words: str) -> set[str]:
    typed = " ".join(f"'{word}'" for word in words)
    ask = f"COMP_WORDS=({typed}); COMP_CWORD={len(words) - 1}; _driftplan; printf '%s\\n' \"${{COMPREPLY[@]}}\""
    done = subprocess.run(["bash", "-uc", f"{script}\n{ask}"], cwd=folder, capture_output=True, text=True, check=True)
    return set(done.stdout.split())


def test_bash_completes_commands_options_choices_and_files(capsys, tmp_path):
    assert main(["completion", "bash"]) == 0
    script = capsys.readouterr().out
    (tmp_path / "route.csv").touch()
    assert completed(script, tmp_path, "driftplan", "") == set(COMMANDS)
    for name, command in COMMANDS.items():
        flags = completed(script, tmp_path, "driftplan", name, "--")
        assert {option.flag for option in command.options} <= flags
        assert {"--json", "--help"} <= flags
    assert completed(script, tmp_path, "driftplan", "place", "--estimator", "") == {"reset", "filter"}
    assert completed(script, tmp_path, "driftplan", "place", "--kind", "r") == {"rfid", "range_only"}
    assert completed(script, tmp_path, "driftplan", "predict", "ro") == {"route.csv"}


def test_zsh_gets_the_same_with_what_makes_it_understand(capsys):
    assert main(["completion", "zsh"]) == 0
    assert capsys.readouterr().out.startswith("autoload -U +X bashcompinit")


def test_another_shell_is_refused(capsys):
    assert main(["completion", "fish"]) == 2
    assert "zsh" in capsys.readouterr().err
