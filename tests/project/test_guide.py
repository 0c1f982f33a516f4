"""The code in the guide runs, and prints what the pages say; every public name has its place in the reference."""

from __future__ import annotations

import doctest
import importlib.util
import inspect
import re
import sys
from pathlib import Path
from types import ModuleType

import pytest

import driftplan

GUIDE = Path(__file__).resolve().parents[2] / "examples/guide"
REFERENCE = sorted((GUIDE / "api").glob("*.md"))


def site_module(name: str) -> ModuleType:
    spec = importlib.util.spec_from_file_location(f"guide_{name}", GUIDE / f"site/{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # where dataclasses look
    spec.loader.exec_module(module)
    return module


pages = site_module("pages")
WITH_CODE = [page for page in sorted(GUIDE.glob("*.md")) if pages.blocks(page) and page.stem != "install"]


def words(printed: str) -> list[str]:
    """What is printed, without its numbers, which may end in other digits elsewhere, and the spaces about them."""
    return re.sub(r"[-+−]?\d[\d.,e-]*", "#", printed).split()


@pytest.mark.slow
@pytest.mark.parametrize("page", WITH_CODE, ids=lambda page: page.stem)
def test_the_code_of_a_page_runs_and_prints_what_the_page_says(page, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    reader = pages.Reader(tmp_path)
    for block in pages.blocks(page):
        printed = reader.run(block)
        if block.printed is not None:
            assert words(printed) == words(block.printed), f"python examples/guide/site/pages.py {page.name} records it"


@pytest.mark.parametrize("page", sorted(GUIDE.rglob("*.md")), ids=lambda page: page.stem)
def test_a_page_shows_no_code_that_nobody_runs(page):
    shown = set(re.findall(r"^```(\w*)", page.read_text(), re.MULTILINE))
    assert shown <= {"sh", "python", "text", "yaml", "json", ""}


def test_every_public_name_is_in_the_reference_once():
    named = [
        name for page in REFERENCE for name in re.findall(r"^::: driftplan\.(\w+)$", page.read_text(), re.MULTILINE)
    ]
    assert sorted(named) == sorted(driftplan.__all__)


@pytest.mark.parametrize("name", driftplan.__all__)
def test_every_public_function_and_class_has_an_example_that_runs(name):
    """pytest runs what `doctest` finds in the modules of driftplan; exceptions need none."""
    public = getattr(driftplan, name)
    if inspect.isfunction(public) or (inspect.isclass(public) and not issubclass(public, Exception)):
        assert [test for test in doctest.DocTestFinder(recurse=False).find(public) if test.examples]


def test_docstrings_say_what_they_mean_themselves():
    elsewhere = re.compile(r"\bas there\b|\bsee there\b|\bthe same as there\b")
    assert [n for n in driftplan.__all__ if elsewhere.search(inspect.getdoc(getattr(driftplan, n)) or "")] == []


NUMBERS = ["zero", "one", "two", "three", "four", "five", "six", "seven", "eight", "nine", "ten", "eleven", "twelve"]


@pytest.mark.parametrize(
    ("page", "said", "counted"),
    [
        ("own-map.md", r"\*\*(\w+) commands\*\*", r"^driftplan "),
        ("first-hour.md", r"^(\w+) commands, from", r"^driftplan "),
        ("aisles.md", r"(\w+) cells\.$", r"^\*\*Cell \d"),
        ("ompl.md", r"\*\*(\w+) line changes\*\*", r"# the line that changed"),
    ],
)
def test_a_page_takes_as_many_commands_as_it_says(page, said, counted):
    text = (GUIDE / page).read_text()
    (number,) = re.findall(said, text, re.MULTILINE)
    assert len(re.findall(counted, text, re.MULTILINE)) == NUMBERS.index(number.lower())


def test_in_a_script_of_ompls_no_other_line_changes():
    """The two problems of the page are set up alike but for the line that it names."""
    code = (GUIDE / "ompl.md").read_text().split("```python")[1].split("```")[0]
    before, after = re.findall(r"^(\w+), si = setup\(\)\n(.+)$", code, re.MULTILINE)
    assert "PathLengthOptimizationObjective" in before[1]
    assert "DriftObjective" in after[1]
    assert before[1].split("(ob.")[0].removeprefix(before[0]) == after[1].split("(Drift")[0].removeprefix(after[0])


def test_every_page_is_in_the_navigation():
    navigation = (GUIDE / "site/mkdocs.yml").read_text()
    for page in GUIDE.rglob("*.md"):
        assert str(page.relative_to(GUIDE)) in navigation
