"""Make what `driftplan examples` hands out, always the same bytes: ``python examples/data/make_data.py [FOLDER]``.

The robot is invented: it drives rounds in the bundled warehouse, its wheels err as `NOISE` says, and once in the first
drive they spin for half a metre. Lengths are metres, angles radians, times seconds.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Points = list[tuple[float, float]]

ROUTE: Points = [(8, 2.5), (8, 23.8), (44, 23.8)]
OTHER: Points = [(8, 2.5), (21.5, 2.5), (21.5, 13.4), (44, 13.4)]
TRIPS = [((8, 2.5), (44, 23.8), 20), ((8, 2.5), (44, 13.4), 10), ((8, 35), (56, 2.5), 5)]
# variances of heading and distance per metre, and per radian turned
NOISE = {"heading_var_per_m": 3e-5, "heading_var_per_rad": 2e-4, "distance_var_per_m": 2.5e-4}
SPEED_M_PER_S, TURN_RAD_PER_S, RATE_HZ = 0.8, 0.8, 4.0
SLIP_M = 0.5


def poses(waypoints: Points, rounds: int) -> NDArray[np.float64]:
    """True (t, x, y, heading), of a robot that drives straight, turns on the spot, and goes there and back."""
    there_and_back = (waypoints + waypoints[-2::-1]) if rounds > 1 else waypoints
    points = [complex(*p) for p in there_and_back]
    points += rounds // 2 * points[1:] if rounds > 3 else []
    rows: list[tuple[float, complex, float]] = []
    time, heading = 0.0, float(np.angle(points[1] - points[0]))
    for here, there in pairwise(points):
        turn = float(np.angle((there - here) * np.exp(-1j * heading)))
        for share in np.arange(0, 1, TURN_RAD_PER_S / RATE_HZ / max(abs(turn), 1e-9)) if turn else ():
            rows.append((time, here, heading + share * turn))
            time += 1 / RATE_HZ
        heading += turn
        for share in np.arange(0, 1, SPEED_M_PER_S / RATE_HZ / abs(there - here)):
            rows.append((time, here + share * (there - here), heading))
            time += 1 / RATE_HZ
    rows.append((time, points[-1], heading))
    return np.array([(t, p.real, p.imag, h) for t, p, h in rows])


def odometry(truth: NDArray[np.float64], rng: np.random.Generator, slip_after_m: float = np.inf) -> NDArray[np.float64]:
    """(t, x, y, heading) that wheels would tell of the drive, from (0, 0, 0)."""
    places = truth[:, 1] + 1j * truth[:, 2]
    steps, turns = np.abs(np.diff(places)), np.diff(truth[:, 3])
    directions = np.where(steps > 0, np.angle(np.diff(places) * np.exp(-1j * truth[:-1, 3])), 0.0)
    heading_var = NOISE["heading_var_per_m"] * steps + NOISE["heading_var_per_rad"] * np.abs(turns)
    measured = steps + rng.normal(size=len(steps)) * np.sqrt(NOISE["distance_var_per_m"] * steps)
    slips = np.searchsorted(np.cumsum(steps), slip_after_m)
    if slips < len(measured):
        measured[slips] += SLIP_M
    headings = np.concatenate([[0.0], np.cumsum(turns + rng.normal(size=len(turns)) * np.sqrt(heading_var))])
    motion = measured * np.exp(1j * (headings[:-1] + directions))
    way = np.concatenate([[0j], np.cumsum(motion)])
    return np.column_stack([truth[:, 0], way.real, way.imag, headings])


def text(header: str, rows: Iterable[Iterable[float]], decimals: int) -> str:
    """CSV."""
    return "\n".join(
        [header, *(",".join(f"{v:.{decimals}f}".rstrip("0").rstrip(".") for v in row) for row in rows), ""]
    )


def files() -> dict[str, str]:
    """Every file by its name."""
    rng = np.random.default_rng(2024)
    made = {
        "route.csv": text("x,y", ROUTE, 1),
        "other.csv": text("x,y", OTHER, 1),
        "trips.csv": text("start_x,start_y,goal_x,goal_y,weight", [(*a, *b, w) for a, b, w in TRIPS], 1),
    }
    for drive, (waypoints, slip_after_m) in enumerate([(ROUTE, 150.0), (OTHER, np.inf)], start=1):
        truth = poses(waypoints, 6)
        made[f"drive{drive}_truth.csv"] = text("time,x,y,heading", truth, 4)
        made[f"drive{drive}_odometry.csv"] = text("time,x,y,heading", odometry(truth, rng, slip_after_m), 4)
    return made


if __name__ == "__main__":
    folder = Path(sys.argv[1] if len(sys.argv) > 1 else __file__).resolve()
    folder = folder if folder.is_dir() else folder.parent
    for name, content in files().items():
        (folder / name).write_text(content)
        print(folder / name)
