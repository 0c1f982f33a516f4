"""What an option is when it is not given is what the library's keyword of that name is."""

from __future__ import annotations

import inspect

import pytest

import driftplan
from driftplan.planning.request import Reliance
from driftplan.report.cli import build_parser
from driftplan.report.commands import COMMANDS
from driftplan.report.commands.shared import kind_from

CALLED = {  # what a subcommand calls
    "predict": ("predict_drift", "load_world"),
    "plan": ("plan_route", "DriftLimit", "load_world"),
    "compare": ("plan_route", "load_world"),
    "place": ("place_beacons", "beacon_tradeoff", "DriftLimit", "Sites", "load_world"),
    "design": ("co_design", "DriftLimit", "Sites", "load_world"),
    "fit": ("fit_noise",),
    "study": ("run_study",),
    "graph": ("graph_routes",),
}


@pytest.mark.parametrize("name", CALLED)
def test_options_and_keywords_have_the_same_defaults(name):
    """None leaves it to the library; where the library has None, what it makes of that."""
    made_of_none = {"min_capture": Reliance.min_capture}
    compared = 0
    for called in CALLED[name]:
        keywords = inspect.signature(getattr(driftplan, called)).parameters
        for option in COMMANDS[name].options:
            if option.name not in keywords or option.default is None or option.name == "kind":
                continue
            default = keywords[option.name].default
            if default is not inspect.Parameter.empty:
                compared += 1
                assert option.default == (made_of_none[option.name] if default is None else default), option.flag
    assert compared or name in ("graph", "study")


def test_no_search_has_a_knob_that_the_command_line_leaves_out():
    """The node counts, seeds and rounds of a search, without which its answer cannot be had again."""
    keywords = set(inspect.signature(driftplan.co_design).parameters) & {"max_nodes", "rounds", "seed", "time_limit"}
    assert keywords == {"max_nodes", "rounds", "seed", "time_limit"}
    assert keywords <= {option.name for option in COMMANDS["design"].options}


def test_beacons_of_no_other_options_are_those_of_the_library():
    args = build_parser().parse_args(["place", "warehouse", "route.csv", "--max-drift", "1"])
    assert kind_from(args) == driftplan.BeaconKind.rfid(range_m=1.5, position_std_m=0.1)
