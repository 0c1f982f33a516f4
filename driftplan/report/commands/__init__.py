"""The subcommands of driftplan, a file each: a table of options, and the function that answers.

option, shared, answer          what an option is; options of several subcommands; what is printed and written
demo, demo_beacons              the bundled maps planned, compared and drawn; the tags of the demo
predict, plan, compare, place, design, fit, studio, graph,
study, maps, examples, selftest,
completion
                                the subcommand of this name
"""

from __future__ import annotations

from driftplan.report.commands import (
    compare,
    completion,
    demo,
    design,
    examples,
    fit,
    graph,
    maps,
    place,
    plan,
    predict,
    selftest,
    studio,
    study,
)
from driftplan.report.commands.option import Command

COMMANDS: dict[str, Command] = {
    module.COMMAND.name: module.COMMAND
    for module in (
        demo,
        predict,
        plan,
        compare,
        place,
        design,
        fit,
        studio,
        graph,
        study,
        maps,
        examples,
        selftest,
        completion,
    )
}
