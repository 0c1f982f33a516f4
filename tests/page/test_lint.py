"""The page's JavaScript is plain modules that a reader and any browser can follow."""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path

import pytest

from driftplan.page.scene import _MODULES, script

PAGE = Path(__file__).resolve().parents[2] / "driftplan/page"
FILES = sorted(PAGE.glob("*.js"))
TEXTS = {file.stem: file.read_text() for file in FILES}
IMPORT = re.compile(r'^import \{([^}]*)\} from "\./(\w+)\.js";\n', re.MULTILINE)


def imports(text):
    """Names and the modules they come from."""
    return [(name.strip(), module) for names, module in IMPORT.findall(text) for name in names.split(",")]


def declared(text, before=""):
    """Names of the top level, those of ``const a = 1, b = 2`` too."""
    names = re.findall(rf"^{before}(?:async )?(?:function|const|let|class) (\w+)", text, flags=re.MULTILINE)
    lists = re.findall(rf"^{before}const (\w+ = [-\w.* ]+(?:, \w+ = [-\w.* ]+)+);", text, flags=re.MULTILINE)
    return names + [name for more in lists for name in re.findall(r", (\w+) =", more)]


def exports(text):
    return declared(text, "export ")


@pytest.mark.parametrize("file", FILES, ids=lambda file: file.stem)
def test_every_name_that_is_imported_is_there_and_used(file):
    code = IMPORT.sub("", TEXTS[file.stem])
    assert "import " not in code  # of any other form
    for name, module in imports(TEXTS[file.stem]):
        assert name in exports(TEXTS[module])
        assert re.search(rf"\b{name}\b", code), name


def test_every_name_that_is_exported_is_imported_somewhere():
    used = {name for text in TEXTS.values() for name, _ in imports(text)}
    used |= {name for name, _ in imports(Path(__file__).with_name("compute.mjs").read_text())}
    assert {name for text in TEXTS.values() for name in exports(text)} - used == {
        "open",
        "render",
    }  # the page's ways in


def test_modules_come_after_what_they_import_and_no_two_names_are_one():
    assert sorted(_MODULES) == sorted(TEXTS)
    for k, module in enumerate(_MODULES):
        assert {source for _, source in imports(TEXTS[module])} <= set(_MODULES[:k])
    names = declared(script())
    assert len(names) == len(set(names))


@pytest.mark.parametrize("file", FILES, ids=lambda file: file.stem)
def test_the_language_is_used_strictly(file, tmp_path):
    text = re.sub(r"//.*|/\*.*?\*/", "", TEXTS[file.stem])
    assert not re.search(r"[^=!]==[^=]|!=[^=]|\bvar\b|\beval\b|\bwith \(", text)
    assert len(TEXTS[file.stem].splitlines()) < 400
    if (node := shutil.which("node")) is not None:
        (tmp_path / "package.json").write_text('{"type": "module"}')
        shutil.copy(file, tmp_path)
        subprocess.run([node, "--check", file.name], cwd=tmp_path, check=True)
