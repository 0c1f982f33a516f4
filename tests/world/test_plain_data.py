"""YAML from anybody: the same with libyaml as without, and the same things refused."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from driftplan import MapError
from driftplan.world import plain_data

ROOT = Path(__file__).resolve().parents[2]
FILES = sorted(
    file
    for folder in (ROOT / "examples", ROOT / "driftplan", ROOT.parent / "shared/cases", ROOT.parent / "shared/data")
    for file in folder.rglob("*.yaml")
)


@pytest.fixture(scope="module")
def without_libyaml():
    """The module as it is where PyYAML was built without libyaml."""
    spec = importlib.util.spec_from_file_location("plain_data_of_python", plain_data.__file__)
    module = importlib.util.module_from_spec(spec)
    with pytest.MonkeyPatch.context() as patch:
        patch.delattr(yaml, "CSafeLoader", raising=False)
        spec.loader.exec_module(module)
    return module


def read(module, file):
    """What is read, with the lines of keys; or the line of the fault."""
    try:
        return lined(module.read_yaml(file, MapError, max_bytes=10**7))
    except MapError as err:
        where = str(err).removeprefix(str(file)).split(": ")
        return where[:2] if where[0] else where[1]


def lined(held):
    if isinstance(held, dict):
        return [(key, held.lines[key], lined(value)) for key, value in held.items()]
    return [lined(value) for value in held] if isinstance(held, list) else repr(held)


@pytest.mark.parametrize("file", FILES, ids=lambda file: file.name)
def test_every_file_is_the_same_either_way(file, without_libyaml):
    assert read(plain_data, file) == read(without_libyaml, file)


WORDS = st.sampled_from(
    ["a", "b", "1e-4", "1", "0x10", "true", "~", ".inf", "'q'", '"\\u00e4"', "!!int 3", "ü", "2024-01-01"]
)
MARKS = st.sampled_from(
    [": ", ", ", "\n", "\n  ", "\n- ", "{", "}", "[", "]", "&a ", "*a", "# c\n", "? ", "| \n", "<<: "]
)


@given(st.lists(WORDS | MARKS, max_size=12))
@settings(max_examples=150, deadline=None)
def test_every_text_is_the_same_either_way(without_libyaml, tmp_path_factory, parts):
    """Or refused by both: in which words, and in which line of two that belong to it, they may differ."""
    file = tmp_path_factory.getbasetemp() / "some.yaml"
    file.write_text("".join(parts))
    ours, others = read(plain_data, file), read(without_libyaml, file)
    assert ours == others or (isinstance(ours, list) and "YAML" in str(ours[-1]) and "YAML" in str(others[-1]))


@pytest.mark.skipif(not yaml.__with_libyaml__, reason="PyYAML was built without libyaml")
def test_libyaml_is_used_where_it_is(without_libyaml):
    assert issubclass(plain_data._PlainLoader, yaml.CSafeLoader)
    assert not issubclass(without_libyaml._PlainLoader, yaml.CSafeLoader)
    assert "plain_data_of_python" not in sys.modules


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("a: &x 1\nb: *x\n", "line 2: not plain YAML: aliases have no place"),
        ("a: 1\nb: {c: 2,\n d: 1, c: 3}\n", "line 3: not plain YAML: the key 'c' occurs twice"),
        ("- " * 5000, "not plain YAML"),
        ("{a: " * 5000, "not plain YAML"),
        ("a: \x01", "not plain YAML"),
        ("a: !!python/name:os.system\n", "line 1: not plain YAML"),
    ],
)  # fmt: skip
def test_the_gate_is_the_same_either_way(tmp_path, without_libyaml, text, said):
    (tmp_path / "a.yaml").write_text(text)
    for module in (plain_data, without_libyaml):
        with pytest.raises(MapError, match=said):
            module.read_yaml(tmp_path / "a.yaml", MapError, max_bytes=10**6)
