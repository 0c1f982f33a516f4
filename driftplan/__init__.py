"""driftplan: how lost odometry gets along a path, the route on which that is least, and the fewest beacons to help.

Everything a script needs is importable from here. Names are loaded when first used, so that `import driftplan` costs
next to nothing and OMPL, matplotlib and the solvers come in only with what needs them.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .beacons.beacon import Beacon as Beacon
    from .beacons.beacon import BeaconKind as BeaconKind
    from .beacons.readings import DetectionChance as DetectionChance
    from .beacons.readings import beacon_passes as beacon_passes
    from .beacons.readings import detection_chances as detection_chances
    from .beacons.readings import drift_with_beacons as drift_with_beacons
    from .errors import DriftplanError as DriftplanError
    from .errors import GoalError as GoalError
    from .errors import InfeasibleError as InfeasibleError
    from .errors import MapError as MapError
    from .errors import NoPathError as NoPathError
    from .errors import PlannerError as PlannerError
    from .errors import StartError as StartError
    from .errors import TrajectoryError as TrajectoryError
    from .layouts.co_design.co_design import co_design as co_design
    from .layouts.co_design.design import CoDesign as CoDesign
    from .layouts.co_design.trips import Trip as Trip
    from .layouts.co_design.trips import load_trips as load_trips
    from .layouts.layout import Layout as Layout
    from .layouts.layout_files import installer_table as installer_table
    from .layouts.layout_files import layout_csv as layout_csv
    from .layouts.layout_files import layout_geojson as layout_geojson
    from .layouts.layout_files import load_beacons as load_beacons
    from .layouts.placement.candidates import grid_sites as grid_sites
    from .layouts.placement.candidates import route_sites as route_sites
    from .layouts.placement.candidates import wall_sites as wall_sites
    from .layouts.placement.place import beacon_tradeoff as beacon_tradeoff
    from .layouts.placement.place import place_beacons as place_beacons
    from .layouts.placement.problem import SiteGroup as SiteGroup
    from .model.calibration.fit import NoiseFit as NoiseFit
    from .model.calibration.fit import fit_noise as fit_noise
    from .model.calibration.noise_check import check_noise as check_noise
    from .model.calibration.recordings import OdometryLog as OdometryLog
    from .model.calibration.recordings import Trajectory as Trajectory
    from .model.calibration.relative_errors import relative_errors as relative_errors
    from .model.calibration.simulated_log import simulate_log as simulate_log
    from .model.calibration.umbmark import umbmark as umbmark
    from .model.drift import Drift as Drift
    from .model.drift import PointDrift as PointDrift
    from .model.drift import predict_drift as predict_drift
    from .model.noise import OdometryNoise as OdometryNoise
    from .model.paths import Run as Run
    from .model.paths import Runs as Runs
    from .model.presets import PRESETS as PRESETS
    from .model.presets import Preset as Preset
    from .model.readings import Fix as Fix
    from .model.simulation import simulate_drift as simulate_drift
    from .model.spatial.drift import SpatialDrift as SpatialDrift
    from .model.spatial.drift import predict_drift_3d as predict_drift_3d
    from .model.spatial.drift import predict_flight_drift as predict_flight_drift
    from .model.spatial.rotations import RotationNoise as RotationNoise
    from .model.spatial.simulation import simulate_drift_3d as simulate_drift_3d
    from .model.spatial.steps import flight_steps as flight_steps
    from .planning.comparison import Comparison as Comparison
    from .planning.comparison import compare_routes as compare_routes
    from .planning.itinerary.itinerary import Itinerary as Itinerary
    from .planning.itinerary.pareto import pareto_routes as pareto_routes
    from .planning.itinerary.roadmap_planner import RoadmapPlanner as RoadmapPlanner
    from .planning.ompl.collision import use_world as use_world
    from .planning.ompl.objective import DriftObjective as DriftObjective
    from .planning.ompl.paths import predict_ompl_path as predict_ompl_path
    from .planning.plan import plan_route as plan_route
    from .planning.routes import Route as Route
    from .report.plot_beacons import layout_figure as layout_figure
    from .report.plot_beacons import plot_importance as plot_importance
    from .report.plot_beacons import plot_layout as plot_layout
    from .report.plot_beacons import plot_sawtooth as plot_sawtooth
    from .report.plot_beacons import plot_tradeoff as plot_tradeoff
    from .report.plot_fit import plot_fit as plot_fit
    from .report.plotting import plot_comparison as plot_comparison
    from .report.plotting import plot_drift as plot_drift
    from .report.plotting import plot_route as plot_route
    from .report.plotting import plot_world as plot_world
    from .world.mapfiles import bundled_map as bundled_map
    from .world.mapfiles import bundled_maps as bundled_maps
    from .world.mapfiles import load_world as load_world
    from .world.mapfiles import save_world as save_world
    from .world.noise_files import load_noise as load_noise
    from .world.noise_files import save_noise as save_noise
    from .world.odometry_logs import read_odometry as read_odometry
    from .world.odometry_logs import read_truth as read_truth
    from .world.trajectories import read_path as read_path
    from .world.trajectories import read_trajectory as read_trajectory
    from .world.world import World as World
    from .world.zone_files import load_zones as load_zones
    from .world.zones import Zone as Zone

_HOME = {
    "beacons.beacon": "Beacon BeaconKind",
    "layouts.placement.candidates": "grid_sites route_sites wall_sites",
    "beacons.readings": "DetectionChance beacon_passes detection_chances drift_with_beacons",
    "layouts.co_design.co_design": "co_design",
    "layouts.co_design.design": "CoDesign",
    "planning.itinerary.itinerary": "Itinerary",
    "layouts.layout": "Layout",
    "layouts.layout_files": "installer_table layout_csv layout_geojson load_beacons",
    "planning.itinerary.pareto": "pareto_routes",
    "layouts.placement.place": "beacon_tradeoff place_beacons",
    "layouts.placement.problem": "SiteGroup",
    "planning.plan": "plan_route",
    "planning.itinerary.roadmap_planner": "RoadmapPlanner",
    "layouts.co_design.trips": "Trip load_trips",
    "errors": ("DriftplanError GoalError InfeasibleError MapError NoPathError PlannerError StartError TrajectoryError"),
    "model.calibration.fit": "NoiseFit fit_noise",
    "model.drift": "Drift PointDrift predict_drift",
    "model.readings": "Fix",
    "model.noise": "OdometryNoise",
    "model.calibration.noise_check": "check_noise",
    "model.paths": "Run Runs",
    "model.presets": "PRESETS Preset",
    "model.calibration.recordings": "OdometryLog Trajectory",
    "model.calibration.relative_errors": "relative_errors",
    "model.spatial.rotations": "RotationNoise",
    "model.calibration.simulated_log": "simulate_log",
    "model.simulation": "simulate_drift",
    "model.spatial.drift": "SpatialDrift predict_drift_3d predict_flight_drift",
    "model.spatial.simulation": "simulate_drift_3d",
    "model.spatial.steps": "flight_steps",
    "model.calibration.umbmark": "umbmark",
    "planning.ompl.collision": "use_world",
    "planning.ompl.objective": "DriftObjective",
    "planning.ompl.paths": "predict_ompl_path",
    "planning.comparison": "Comparison compare_routes",
    "planning.routes": "Route",
    "report.plot_beacons": "layout_figure plot_importance plot_layout plot_sawtooth plot_tradeoff",
    "report.plot_fit": "plot_fit",
    "report.plotting": "plot_comparison plot_drift plot_route plot_world",
    "world.mapfiles": "bundled_map bundled_maps load_world save_world",
    "world.noise_files": "load_noise save_noise",
    "world.odometry_logs": "read_odometry read_truth",
    "world.trajectories": "read_path read_trajectory",
    "world.world": "World",
    "world.zone_files": "load_zones",
    "world.zones": "Zone",
}
_MODULE_OF = {name: module for module, names in _HOME.items() for name in names.split()}

__all__ = sorted(_MODULE_OF)


def __getattr__(name: str) -> Any:
    if name not in _MODULE_OF:
        raise AttributeError(f"module 'driftplan' has no attribute {name!r}")
    value = getattr(import_module(f".{_MODULE_OF[name]}", __name__), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
