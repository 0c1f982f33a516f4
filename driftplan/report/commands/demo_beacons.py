"""The end of the demo: RFID tags for five rounds through the bundled warehouse."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from driftplan.errors import InfeasibleError
from driftplan.report.records import record
from driftplan.tables import counted

if TYPE_CHECKING:
    from driftplan import Layout, OdometryNoise, World
    from driftplan.model.readings import Estimator

ROUNDS = (  # waypoints in metres: from the docks and gates into the aisles, some of them there and back
    ((2.5, 38), (2.5, 36), (8, 34), (8, 13.4), (46, 13.4), (8, 13.4), (8, 3)),
    ((3, 3), (8, 8), (8, 23.8), (46, 23.8), (8, 23.8), (8, 36)),
    ((46, 37), (10, 36), (8, 34), (8, 19), (8, 3), (58, 3)),
    ((50.8, 30), (50.8, 11), (48, 9), (22, 9), (21.5, 13.4), (21.5, 18), (23.5, 18.7)),
    ((57.5, 29.5), (50.5, 30.2), (47.5, 29.8), (8, 29.8), (8, 19.4), (46, 19.4)),
)
LIMIT_M = 0.8
_TIME_LIMIT_S = 60.0  # it takes a few


def demo_layout(world: World, noise: OdometryNoise, estimator: Estimator = "reset") -> Layout | str:
    """The fewest tags that keep every round under `LIMIT_M`, or in words why there are none."""
    from driftplan import BeaconKind, Sites, place_beacons

    if noise.step_m is not None:
        return "no beacons are placed: that takes noise per metre, not per step"
    tag = BeaconKind.rfid(range_m=1.5, position_std_m=0.1)
    try:
        asked: dict[str, Any] = {"estimator": estimator, "time_limit": _TIME_LIMIT_S}
        return place_beacons(world, ROUNDS, noise, LIMIT_M, Sites(tag, spacing_m=1.5), **asked)
    except InfeasibleError as err:
        return f"no tags keep the drift of all rounds under {LIMIT_M:g} m with this odometry: {err}"


def sentence(layout: Layout | str) -> str:
    """What was found, in a line."""
    if isinstance(layout, str):
        return layout
    bare = max(layout.scenario.worst(layout.scenario.drift(r, ())) for r in range(len(layout.drifts)))
    number = len(layout.beacons)
    proof = "no fewer will do" if layout.proven else f"at least {layout.lower_bound:g} are needed"
    return (
        f"{counted(number, 'RFID tag')} keep{'s' * (number == 1)} the drift of {len(ROUNDS)} "
        f"rounds under {LIMIT_M:g} m everywhere ({proof}); without tags it reaches {bare:.2f} m"
    )


def as_json(layout: Layout | str) -> dict[str, Any]:
    """The layout by the names of ``driftplan place --json``."""
    if isinstance(layout, str):
        return {"none": layout}
    return {
        "beacons": [record(beacon, "id", "x_m", "y_m") for beacon in layout.beacons],
        "limit_m": LIMIT_M,
        **record(layout, "lower_bound", "proven", "worst_drift_m"),
    }
