"""``driftplan study`` from the first file to the report, and the report in a real browser."""

from __future__ import annotations

import importlib.util
import json
import sys
from pathlib import Path

import pytest

from driftplan import load_beacons
from driftplan.layouts.study.study import study_schema

STUDY = {
    "routes": [[[0, 0], [60, 0]], [[0, 5], [60, 5], [60, 20]]],
    "noise": {"heading_deg": 2, "distance_m": 0.05},
    "beacon": {"kind": "landmark", "range_m": 2.0, "position_std_m": 0.05, "heading_std_deg": 0.5},
    "simulated_drives": 50,
    "vary": {"limit_m": [0.01, 0.5, 0.7, 0.9], "noise.heading_deg": [1, 2]},
}


@pytest.fixture
def file(tmp_path):
    (tmp_path / "s.yaml").write_text(json.dumps(STUDY))
    return tmp_path / "s.yaml"


def test_a_study_is_begun_checked_and_never_overwritten(run, refused, tmp_path):
    assert run("study", "init", tmp_path / "new.yaml").code == 0
    refused("study", "init", tmp_path / "new.yaml", match="which would be overwritten")
    refused("study", "run", match="expected a study file")
    assert json.loads(run("study", "schema").out) == json.loads(json.dumps(study_schema()))


def test_check_does_nothing_run_does_what_is_missing_and_show_says_it(run, file):
    checked = json.loads(run("study", "check", file, "--json").out)["study"]
    assert (checked["cells"], checked["missing"], len(checked["tried"])) == (8, 8, 3)
    assert not file.with_suffix(".results.jsonl").exists()
    assert "8 cells, 8 missing" in run("study", "show", file).out
    _, out, err = run("study", "run", file, "--csv", file.with_suffix(".csv"))
    assert [f"wrote {file.with_suffix(end)}" in err for end in (".results.jsonl", ".csv")] == [True, True]
    assert "8 cells, 6 done, 2 infeasible." in out
    assert "infeasible (" in out
    assert "Simulated drives: of 12 route ends" in out
    assert len(file.with_suffix(".csv").read_text().splitlines()) == 9
    assert run("study", "show", file).out == out
    answer = json.loads(run("study", "show", file, "--json").out)["study"]
    tags = file.with_suffix(".geojson")
    run("study", "show", file, "--cell", 3, "--geojson", tags)
    assert len(load_beacons(tags)) == answer["rows"][3]["beacons"]


def test_options_that_do_nothing_are_refused(refused, file):
    refused("study", "show", file, "--workers", 2, match="--workers would have no effect: only run does cells")
    refused("study", "show", file, "--cell", 99, "--geojson", "-", match=r"expected --cell in \[0, 8\), got 99")
    refused("study", "show", file, "--cell", 1, match="expected --cell and geojson together")


@pytest.mark.slow
def test_the_report_draws_in_a_browser_and_asks_nothing_of_any_network(run, file):
    path = Path(__file__).resolve().parents[1] / "page/browser.py"
    spec = importlib.util.spec_from_file_location("study_browser", path)
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    if module.chromium() is None:
        pytest.skip("no browser")
    html = file.with_suffix(".html")
    run("study", "run", file, "--html", html)
    browser = module.Browser()
    try:
        browser.open_blank()
        browser.call("Page.navigate", url=html.as_uri())
        browser.until("document.documentElement?.dataset.ready")
        assert browser.js("document.querySelectorAll('.dot').length") == 6
        assert browser.js("document.querySelectorAll('.none').length") == 2  # nothing will do at a limit of 1 cm
        browser.js("document.querySelectorAll('.dot')[1].dispatchEvent(new MouseEvent('click', {bubbles: true}))")
        assert browser.js("document.querySelectorAll('.placed').length") > 0
        assert browser.complaints == []
        assert browser.requests == [html.as_uri()]
    finally:
        browser.close()
