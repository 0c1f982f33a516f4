"""``driftplan study``: a scenario with some of it varied, its cells done on all cores or a cluster, and the answers."""

from __future__ import annotations

import argparse
import csv
import io
import time
from contextlib import ExitStack
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from driftplan.report.commands.answer import Answer, Progress, talk
from driftplan.report.commands.option import Command, Group, Idle, Option
from driftplan.report.records import json_text
from driftplan.tables import NONE, counted, table

if TYPE_CHECKING:
    from driftplan.layouts.study.answers import Answers, Curve
    from driftplan.layouts.study.run import StudyResult

_TRIED, _TRY_S = 3, 20.0  # cells from which the time is estimated, and no more begun after so many seconds
_MOST_LINES = 60


def run(args: argparse.Namespace) -> Answer:
    """What the action answers."""
    from driftplan.layouts.study.run import planned_study, run_study

    if args.action == "schema":
        from driftplan.layouts.study.study import study_schema

        return Answer(payload=study_schema, text=lambda: json_text(study_schema()))
    if args.study is None:
        raise ValueError(f"expected a study file: driftplan study {args.action} STUDY.yaml, got none")
    if args.action == "init":
        return _template(Path(args.study))
    if args.action == "check":
        return _checked(planned_study(args.study, args.results))
    if args.action == "show":
        return _shown(args, planned_study(args.study, args.results))
    with ExitStack() as stack:
        executor = None if args.dask is None else stack.enter_context(_client(args.dask))
        asked = {"workers": args.workers, "results": args.results, "retry": args.retry, "progress": _tell}
        result = run_study(args.study, executor, **asked)
    talk(f"wrote {args.results or Path(args.study).with_suffix('.results.jsonl')}")
    return _shown(args, result)


def _client(address: str) -> Any:
    try:
        from distributed import Client
    except ImportError as err:
        raise ImportError("--dask needs Dask: pip install 'driftplan[cluster]'") from err
    return Client(address, timeout=10, set_as_default=False)


def _tell(done: int, count: int, left: float) -> None:
    Progress.news = f"{done} of {count} cells, about {_time(left)} left"


def _time(seconds: float) -> str:
    if seconds < 90:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"


def _template(file: Path) -> Answer:
    if file.exists():
        raise ValueError(f"expected the name of a file that is not there, got {file}, which would be overwritten")
    content = (Path(__file__).parents[2] / "layouts/study/sample.yaml").read_bytes()
    hint = f"A study to begin with is in {file}: driftplan study check {file}"
    return Answer(payload=lambda: {"file": str(file)}, text=lambda: hint, files={file: lambda: content})


def _checked(asked: StudyResult) -> Answer:
    """How many cells there are, and how long they may take: a few of those that are missing are tried."""
    missing = [task for task in asked.tasks if task.key not in asked.rows]
    tried, began = [], time.monotonic()
    for task in missing[:: max(len(missing) // _TRIED, 1)][:_TRIED]:
        if time.monotonic() - began < _TRY_S:
            tried.append(asked.workshop.row(task))
            Progress.news = f"{len(tried)} of {_TRIED} cells tried"
    mean_s = sum(row["spent"]["processor_s"] for row in tried) / max(len(tried), 1)
    found = {
        "cells": len(asked.tasks),
        "missing": len(missing),
        "tried": [{k: row.get(k) for k in ("outcome", "why", "spent")} for row in tried],
        "processor_s": mean_s * len(missing),
    }

    def text() -> str:
        summary = f"{counted(len(asked.tasks), 'cell')}, {len(missing)} of them not done yet."
        if tried:
            outcomes = ", ".join(row["outcome"] for row in tried)
            took = f"{mean_s:.2g} s of processor time each, so about {_time(mean_s * len(missing))} in all on one core"
            summary += f" {counted(len(tried), 'cell')} tried ({outcomes}): {took}."
        return "\n".join([summary, *(f"{row['outcome']}: {row['why']}" for row in tried if "why" in row)])

    return Answer(payload=lambda: {"study": found}, text=text)


def _shown(args: argparse.Namespace, result: StudyResult) -> Answer:
    from driftplan.beacons.beacon_files import beacons_geojson
    from driftplan.layouts.study.answers import answers_of
    from driftplan.report.study_report import study_html

    if (args.cell is None) != (args.geojson is None):
        raise ValueError("expected cell and geojson together: the beacons of that cell, and where to write them")
    if args.cell is not None and not 0 <= args.cell < len(result.cells):
        raise ValueError(f"expected cell in [0, {len(result.cells)}), got {args.cell}")
    answers, title = answers_of(result), result.study.title
    return Answer(
        payload=lambda: {"study": {"title": title, "answers": asdict(answers), "rows": result.to_dicts()}},
        text=lambda: _text(result, answers),
        files={
            "html": lambda: study_html(result),
            "csv": lambda: _csv(result.to_dicts()),
            "geojson": lambda: beacons_geojson(result.beacons(args.cell)),
        },
    )


def _text(result: StudyResult, answers: Answers) -> str:
    outcomes = ", ".join(f"{count} {what}" for what, count in answers.outcomes.items() if count)
    parts = [f"{result.study.title}: {counted(len(result.tasks), 'cell')}, {outcomes}."]
    lines = [line for curve in answers.curves for line in _lines(curve, answers)]
    if lines:
        parts.append(table({heading: [line[heading] for line in lines[:_MOST_LINES]] for heading in lines[0]}))
    if len(lines) > _MOST_LINES:
        parts.append(f"{len(lines) - _MOST_LINES} lines more: --html and --csv have them all.")
    knees = [(curve.values, curve.points[curve.knee]) for curve in answers.curves if curve.knee is not None]
    for values, point in knees[:_MOST_LINES]:
        where = " of " * bool(values) + ", ".join(f"{key} {_cell(value)}" for key, value in values.items())
        parts.append(f"Knee{where}: {point.middle:g} {answers.measure} at {answers.along} {point.x:g}.")
    if answers.matters:
        order = sorted(answers.matters.items(), key=lambda item: -item[1])
        shares = ", ".join(f"{key} {100 * share:.0f} %" for key, share in order)
        parts.append(f"Share of the variance of {answers.measure} that each parameter explains alone: {shares}")
    ends = [end for row in result.rows.values() for end in row.get("ends", ())]
    if ends:
        within = f"{100 * sum(abs(z) < 2 for *_, z in ends) / len(ends):.0f} % are within 2 standard errors"
        most = f"the farthest is {max(abs(z) for *_, z in ends):.1f} away"
        drives = f"Simulated drives: of {counted(len(ends), 'route end')} {within} of the prediction"
        parts.append(f"{drives} (95 % if it is right); {most}.")
    for outcome, why, cells in answers.reasons[:5]:
        parts.append(f"{outcome} ({counted(len(cells), 'cell')}, the first is {cells[0]}): {why}")
    return "\n".join(parts)


def _lines(curve: Curve, answers: Answers) -> list[dict[str, Any]]:
    return [
        {key: _cell(value) for key, value in curve.values.items()}
        | {answers.along: f"{point.x:.4g}", f"{answers.measure}: least": _cell(point.low)}
        | {"middle": _cell(point.middle), "greatest": _cell(point.high)}
        | {"cells": len(point.cells), "infeasible": point.infeasible}
        for point in curve.points
    ]


def _cell(value: Any) -> str:
    return NONE if value is None else f"{value:.4g}" if isinstance(value, (int, float)) else str(value)


def _csv(rows: list[dict[str, Any]]) -> bytes:
    text = io.StringIO()
    writer = csv.DictWriter(text, list(dict.fromkeys(key for row in rows for key in row)), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue().encode()


# fmt: off
_RUN = Group("doing the cells", (
    Option("workers", "N", "in so many processes (default: in this one)", int),
    Option("dask", "ADDRESS", "on the Dask cluster of this scheduler, such as tcp://10.0.0.5:8786", str),
    Option("retry", "", "do cells again that failed or ran out of time"),
))
_SHOW = Group("what is shown", (
    Option("results", "FILE", "rows of the cells (default: STUDY.results.jsonl beside the study)", str),
    Option("cell", "K", "the cell whose beacons --geojson writes", int),
))
COMMAND = Command(
    summary="many scenarios at once: a study file, its cells on all cores or a cluster, and what they say together",
    description="A study is a scenario in a YAML file with some of it varied. ACTION: init writes a commented one; "
    "check says how many cells it has and how long they may take; run does those that are not done yet, and can be "
    "ended and begun again at any moment; show says what is known so far; schema prints the JSON schema of such files.",
    run=run,
    arguments=(
        Option("action", "ACTION", "init, check, run, show or schema", str,
               how={"choices": ("init", "check", "run", "show", "schema")}),
        Option("study", "STUDY.yaml", "the study file", str, how={"nargs": "?"}),
    ),
    groups=(_RUN, _SHOW),
    files={
        "html": "run, show: write the report, one page that needs nothing else",
        "csv": "run, show: write a line per cell",
        "geojson": "show: write the beacons of --cell, for `driftplan plan --beacons` and others",
    },
    idle=(
        Idle(("workers", "dask", "retry"), lambda args: args.action != "run", "only run does cells"),
        Idle(("workers",), lambda args: args.dask is not None, "the cluster has its own workers"),
        Idle(("results",), lambda args: args.action in ("init", "schema"), "there are no results yet"),
        Idle(("cell",), lambda args: args.action not in ("run", "show"), "there are no cells to show"),
    ),
    examples=("run study.yaml --workers 4 --html report.html", "show study.yaml --cell 3 --geojson tags.geojson"),
)
