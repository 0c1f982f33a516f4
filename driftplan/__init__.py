"""driftplan: how lost odometry gets along a path, the route on which that is least, and the fewest beacons to help.

Everything a script needs is importable from here. Names are loaded when first used, so that `import driftplan` costs
next to nothing and OMPL, matplotlib and the solvers come in only with what needs them. Which names there are and where
they live is said in `__init__.pyi` alone.
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
