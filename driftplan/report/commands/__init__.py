"""The subcommands of driftplan, a file each: a table of options, and the function that answers.

option, shared, answer          what an option is; options of several subcommands; what is printed and written
demo, predict, plan, compare, place, design, fit, studio, graph, study, maps, examples, selftest, completion
                                the subcommand of this name
"""

from __future__ import annotations

from importlib import import_module

from driftplan.report.commands.option import Command

_NAMES = (  # in the order of the help
    *("demo", "predict", "plan", "compare", "place", "design", "fit"),
    *("studio", "graph", "study", "maps", "examples", "selftest", "completion"),
)
COMMANDS: dict[str, Command] = {name: import_module(f"{__name__}.{name}").COMMAND for name in _NAMES}
