"""What the rows of a study say together: curves with their spread, where they bend, which parameter matters most."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from driftplan.arrays import is_number
from driftplan.layouts.study.run import StudyResult
from driftplan.layouts.study.study import Values
from driftplan.layouts.study.work import DONE, FAILED, INFEASIBLE, OUT_OF_TIME, Row

_MOST_LINES_OF, _MOST_PLACES = 8, 24  # values of a key that make lines; of the key along the axis, before it is binned
_BINS = 8
_FLAT = 0.1  # of both spans: a curve that bends less has no knee


@dataclass(frozen=True)
class Point:
    """Cells of a curve at one place: the least, middle and greatest measure of those that are done."""

    x: float
    low: float | None
    middle: float | None
    high: float | None
    cells: tuple[int, ...]
    infeasible: int


@dataclass(frozen=True)
class Curve:
    """A measure against the key along the axis, for some values of other keys.

    ``knee``: position of the point farthest below the chord between the ends, both spans taken for 1 (the "knee" of
    Satopää and others, Finding a "kneedle" in a haystack, 2011, doi 10.1109/ICDCSW.2011.20); None where it hardly bends
    """

    values: Values
    points: tuple[Point, ...]
    knee: int | None


@dataclass(frozen=True)
class Answers:
    """`answers_of` a study."""

    measure: str  # what curves are of
    along: str  # the key that they run along; "" if no number was varied
    curves: tuple[Curve, ...]  # one for every combination of the other keys but for the seed, over which they spread
    matters: dict[str, float]  # share of the measure's variance that each varied key explains alone
    outcomes: dict[str, int]  # how many cells are done, infeasible, out of time, failed and missing
    reasons: tuple[tuple[str, str, tuple[int, ...]], ...]  # why cells are not done: outcome, words, and the cells


def answers_of(result: StudyResult) -> Answers:
    """What the cells that are done say."""
    rows = result.to_dicts()
    done = [row for row in rows if row["outcome"] == DONE]
    limited = any("beacons" in row for row in done) and "limit_m" in {*result.study.scenario, *result.study.vary}
    measure = "beacons" if limited else "worst_drift_m"
    varied = {key: list(dict.fromkeys(row[key] for row in rows)) for key in result.study.vary}
    numeric = [key for key, found in varied.items() if key != "seed" and len(found) > 1 and all(map(is_number, found))]
    along = "limit_m" if "limit_m" in numeric else next(iter(numeric), "")
    lines = [key for key, found in varied.items() if key not in (along, "seed") and len(found) <= _MOST_LINES_OF]
    groups: dict[tuple[Any, ...], list[Row]] = {}
    for row in rows:
        groups.setdefault(tuple(row[key] for key in lines), []).append(row)
    counts = Counter(row["outcome"] for row in rows)
    reasons: dict[tuple[str, str], list[int]] = {}
    for row in rows:
        if "why" in row:
            reasons.setdefault((row["outcome"], row["why"]), []).append(row["cell"])
    return Answers(
        measure,
        along,
        tuple(_curve(dict(zip(lines, k, strict=True)), found, along, measure) for k, found in groups.items() if along),
        {key: _explained([row[key] for row in done], [row[measure] for row in done]) for key in varied},
        {key: counts[key] for key in (DONE, INFEASIBLE, OUT_OF_TIME, FAILED)} | {"missing": result.missing},
        tuple((*key, tuple(cells)) for key, cells in reasons.items()),
    )  # fmt: skip


def _curve(values: Values, rows: Sequence[Row], along: str, measure: str) -> Curve:
    x = np.array([row[along] for row in rows], dtype=float)
    few = len(set(x.tolist())) <= _MOST_PLACES
    place = np.unique(x, return_inverse=True)[1] if few else _binned(x, _MOST_PLACES // 2)
    points = []
    for k in np.unique(place).tolist():
        here = [row for row, p in zip(rows, place.tolist(), strict=True) if p == k]
        found = np.array([row[measure] for row in here if row["outcome"] == DONE], dtype=float)
        low, middle, high = np.quantile(found, [0.0, 0.5, 1.0]).tolist() if len(found) else (None, None, None)
        infeasible = sum(row["outcome"] == INFEASIBLE for row in here)
        cells = tuple(row["cell"] for row in here)
        points.append(Point(float(x[place == k].mean()), low, middle, high, cells, infeasible))
    return Curve(values, tuple(points), knee(points))


def knee(points: Sequence[Point]) -> int | None:
    """The position of the knee of a falling curve through the points that have a middle."""
    places = [(k, p.x, p.middle) for k, p in enumerate(points) if p.middle is not None]
    if len(places) < 3 or places[0][2] <= places[-1][2]:
        return None
    at, x, y = np.array(places).T
    below = (x[-1] - x) / (x[-1] - x[0]) - (y - y[-1]) / (y[0] - y[-1])
    best = int(np.argmax(below))
    return int(at[best]) if below[best] > _FLAT else None


def _binned(values: np.ndarray[Any, Any], bins: int) -> np.ndarray[Any, Any]:
    """Which of so many parts of about equal size each value is in."""
    borders = np.quantile(values, np.linspace(0, 1, bins + 1)[1:-1])
    return np.searchsorted(borders, values, side="right")


def _explained(levels: Sequence[Any], values: Sequence[float]) -> float:
    """The share of the variance of values that their level explains, less what chance would (Kelley's epsilon squared);
    numbers of many levels are put into eight bins."""
    y = np.array(values, dtype=float)
    if len(y) < 2 or np.ptp(y) == 0:
        return 0.0
    if len(set(levels)) > _BINS and all(map(is_number, levels)):
        level = _binned(np.array(levels, dtype=float), _BINS)
    else:
        level = np.unique([str(one) for one in levels], return_inverse=True)[1]
    counts = np.bincount(level)
    means = np.bincount(level, y)[counts > 0] / counts[counts > 0]
    total = float(((y - y.mean()) ** 2).sum())
    within = total - float(counts[counts > 0] @ (means - y.mean()) ** 2)
    free = len(y) - len(means)
    return max(1 - within / free * (len(y) - 1) / total, 0.0) if free else 0.0
