"""driftplan: how lost odometry gets along a path, the route on which that is least, and the fewest beacons to help.

Everything a script needs is importable from here. Names are loaded when first used, so that `import driftplan` costs
next to nothing and OMPL, matplotlib and the solvers come in only with what needs them. Which names there are and where
they live is said in `__init__.pyi` alone.

Imports only go up the list errors < model < world < beacons < page < planning < layouts < report; `literature` stands
beside, on model. To change

what a reading does to the error           model/readings.py (Resets.apply); in a filter: model/filter_state.py (read)
what beacons measure                       beacons/beacon.py, beacons/readings.py; report/commands/shared.py
where a beacon is in sight                 world/world.py (line_of_sight), beacons/passes.py
the chance that a drifted robot meets one  beacons/readings.py (chances_of_passes)
the chance that it touches a wall          planning/collision_chance.py
a score of the drift                       model/scores.py, model/drift.py; as a limit: planning/request.py (DriftLimit)
a law of heading errors                    model/heading_laws.py, model/noise.py
a format of maps                           a reader beside world/movingai_map.py, a line in world/mapfiles.py
a format of odometry logs                  world/odometry_logs.py
how obstacles grow by the robot's radius   world/inflation.py
options of plan_route, default planner     planning/request.py, planning/routes.py; report/commands/shared.py
OMPL's planners on offer                   planning/ompl/solve.py; report/commands/shared.py
options of RoadmapPlanner                  planning/ompl/roadmap_planner.py
neighbours of a roadmap's node             planning/roadmap/growth.py
the price of a turn                        planning/cost.py (turn_cost); in OMPL: planning/ompl/motion_prices.py
time limit of place_beacons                layouts/place.py; report/commands/place.py
why no layout will do                      layouts/placement/placement_diagnosis.py
the price of a co-design                   layouts/co_design/design_problem.py
what the studio draws and edits            page/studio.js; what it computes: page/drift.js
what the studio may ask of Python          report/studio.py, page/host.js
keys of a study file, what a cell answers  layouts/study/schema.yaml, layouts/study/inputs.py; layouts/study/work.py
columns of the installers' table           layouts/layout_files.py (InstallerRow); report/commands/place.py
options of driftplan plan                  report/commands/plan.py; shared ones: report/commands/shared.py
"""

from __future__ import annotations

import os
import re
import sys
from functools import cached_property
from importlib import import_module
from pathlib import Path
from threading import Lock, RLock
from typing import Any

_IMPORT = re.compile(r"^from (\.\S+) import (\w+) as \2$", re.MULTILINE)
_MODULE_OF = {name: module for module, name in _IMPORT.findall(Path(__file__).with_suffix(".pyi").read_text())}

__all__ = sorted(_MODULE_OF)
_FIRST_HOUR = (
    *("OdometryNoise", "predict_drift", "simulate_drift", "load_world", "bundled_map", "plan_route", "compare_routes"),
    *("BeaconKind", "place_beacons", "drift_with_beacons", "Beacon", "read_path", "read_odometry", "read_truth"),
    *("fit_noise", "load_noise", "plot_world", "plot_route", "plot_drift", "plot_comparison", "layout_figure"),
)


def __getattr__(name: str) -> Any:
    if name not in _MODULE_OF:
        raise AttributeError(f"module 'driftplan' has no attribute {name!r}")
    value = getattr(import_module(_MODULE_OF[name], __name__), name)
    if callable(value):
        from driftplan.door import with_door

        value = with_door(value)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    """The names of the first hour, in the order in which they are met; all there are: ``__all__``."""
    return list(_FIRST_HOUR)


def _free_locks() -> None:
    """A forked process finds no lock held by threads that it has not: of a module, or (Python 3.11) of a property."""
    for module in [module for name, module in sys.modules.items() if name.startswith("driftplan.")]:
        for name, value in list(vars(module).items()):
            if isinstance(value, type(Lock())):
                setattr(module, name, Lock())
            for part in vars(value).values() if isinstance(value, type) else ():
                if isinstance(part, cached_property) and hasattr(part, "lock"):
                    part.lock = RLock()


os.register_at_fork(after_in_child=_free_locks)
