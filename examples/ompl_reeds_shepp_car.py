"""The car of ompl_dubins_car.py with a reverse gear: Reeds-Shepp curves, each tested exactly for collisions."""

from __future__ import annotations

from ompl import base as ob
from ompl import util as ou
from ompl_dubins_car import plan


def main(seconds: float = 5.0) -> None:
    """Plan for a turning radius of 1 m."""
    ou.setLogLevel(ou.LOG_NONE)
    length, rms = plan(ob.ReedsSheppStateSpace(1.0), seconds)
    print(f"Reeds-Shepp car: {length:.1f} m, rms drift {rms:.2f} m at the goal")


if __name__ == "__main__":
    main()
