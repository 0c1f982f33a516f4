"""``driftplan fit``: the noise of an odometry from recorded drives, checked on others."""

from __future__ import annotations

import argparse
from itertools import chain
from math import radians
from pathlib import Path
from typing import TYPE_CHECKING, Any

from driftplan.report.commands.answer import Answer, talk
from driftplan.report.commands.option import Command, Group, Option, input_file, metres, names
from driftplan.report.records import record
from driftplan.tables import counted

if TYPE_CHECKING:
    from driftplan import NoiseFit, OdometryLog, Trajectory
    from driftplan.model.calibration.noise_check import SegmentCheck

    Drive = tuple[OdometryLog, Trajectory]


def run(args: argparse.Namespace) -> Answer:
    """The noise of the drives that the arguments name."""
    from driftplan.model.calibration.fit import PARAMETERS, fit_noise
    from driftplan.report.figures.fits import plot_fit
    from driftplan.world.noise_files import noise_yaml, ros_covariances

    drives = list(_recorded(args, args.files).values())
    checked = {label: [drive] for label, drive in _recorded(args, args.check).items()}
    if args.check_from is not None:
        drives, rest = _split(drives, args.check_from)
        checked = {"the rest of the drives": rest, **checked}
    offset = None if args.heading_offset_deg is None else radians(args.heading_offset_deg)
    options: dict[str, Any] = {name: getattr(args, name) for name in ("lengths_m", "time_offset_s", "max_gap_s")}
    options |= {"heading_offset": offset, "use_heading": False if args.positions_only else None}
    talk(f"fitting {counted(len(drives), 'drive')}")
    asked = {"parameters": args.parameters or PARAMETERS, "confidence": args.confidence, "seed": args.seed}
    found = fit_noise(*_columns(drives), **options | asked)
    if found.faults and not args.accept_faults:
        raise ValueError(" ".join([*found.faults, "To have the numbers all the same: --accept-faults."]))
    if not found.check.has_heading:
        options["use_heading"] = False
    checks = {label: found.check_on(*_columns(some), **options) for label, some in checked.items()}
    checked_on = [[f"\nchecked on {label}:", str(check), check.trust, *check.notes] for label, check in checks.items()]

    def messages() -> bytes:
        if args.speed is None:
            raise ValueError("expected --speed, the robot's in m/s, with --ros: its twist's covariance grows with it")
        return ros_covariances(found.noise, rate_hz=args.message_rate_hz, speed_m_per_s=args.speed).encode()

    return Answer(
        payload=lambda: _as_json(found, checks),
        text=lambda: "\n".join([str(found), *chain(*checked_on)]),
        files={"yaml": lambda: noise_yaml(found), "ros": messages, "picture": lambda: plot_fit(found, checks)},
    )


def _columns(drives: list[Drive]) -> tuple[list[OdometryLog], list[Trajectory]]:
    return [odometry for odometry, _ in drives], [truth for _, truth in drives]


def _recorded(args: argparse.Namespace, files: list[str]) -> dict[str, Drive]:
    """Drives by the name of their odometry's file, as short as tells them apart."""
    from driftplan import read_odometry, read_truth

    if len(files) % 2:
        raise ValueError(f"expected files in pairs, ODOM TRUTH ODOM TRUTH ..., got {len(files)}: {' '.join(files)}")
    short = [Path(odometry).name for odometry in files[::2]]
    names = short if len(set(short)) == len(short) else files[::2]
    driven, true = (
        {"columns": getattr(args, f"{which}_columns"), "variable": getattr(args, f"{which}_variable")}
        for which in ("odometry", "truth")
    )
    driven |= {"kind": args.odometry_kind, "track_width_m": args.track_width_m, "metres_per_tick": args.metres_per_tick}
    at = {"rate_hz": args.rate_hz}
    return {
        name: (read_odometry(odometry, **at, **driven), read_truth(truth, **at, **true))
        for name, odometry, truth in zip(names, files[::2], files[1::2], strict=True)
    }


def _split(drives: list[Drive], share: float) -> tuple[list[Drive], list[Drive]]:
    """The first part of every drive, and the rest."""
    if not 0 < share < 1:
        raise ValueError(f"expected --check-from in (0, 1), got {share}")
    first, rest = [], []
    for odometry, truth in drives:
        begin, end = float(odometry.times[0]), float(odometry.times[-1])
        border = begin + share * (end - begin)
        first.append((odometry.between(begin, border), truth))
        rest.append((odometry.between(border, end), truth))
    return first, rest


def _as_json(found: NoiseFit, checks: dict[str, SegmentCheck]) -> dict[str, Any]:
    errors, counts = found.relative_errors, found.counts
    return {
        "noise": found.noise.given(),
        **record(found, "confidence", "intervals", "std_errors", "truth_position_std_m", "truth_heading_std_rad"),
        **record(found, "time_offsets_s", "heading_offsets_rad", "notes"),
        "recordings": record(counts, *counts.__dataclass_fields__),
        "fit": record(found.check, "lengths", "notes"),
        "held_out": record(found.held_out, "lengths", "notes"),
        "relative_errors": errors and record(errors, "lengths", "translation_percent", "rotation_deg_per_m"),
        "checks": {label: record(check, "lengths", "trust", "notes") for label, check in checks.items()},
    }


# fmt: off
_DRIVES = (
    Option("check", "FILE", "drives to check the fit on, ODOM TRUTH ODOM TRUTH ..., that are not fitted", str, [],
           how={"nargs": "+"}),
    Option("check_from", "SHARE", "fit the drives up to this share of their time (0 to 1), check on the rest"),
)
_READING = Group("what the files hold", (
    Option("odometry_kind", "", "increments: time, distance, turn; velocities: time, forward speed, turn rate; poses "
           "(default: as the columns' names or number say)", str, choices=("increments", "velocities", "poses")),
    *(option for which in ("odometry", "truth") for option in (
        Option(f"{which}_columns", "NAME,NAME,...", f"columns of the {which}: time, distance, turn, speed, turn_rate, "
               "x, y, heading, qx, qy, qz, qw, left_speed, right_speed, left_ticks, right_ticks; any other name is "
               "skipped; units as in time[ns] or heading[deg]", names),
        Option(f"{which}_variable", "NAME", f"MATLAB variable or ROS topic with the {which}", str),
    )),
    Option("rate_hz", "HZ", "poses per second of KITTI files", default=10.0),
    Option("track_width_m", "M", "distance between the wheels, metres, of wheel speeds or ticks"),
    Option("metres_per_tick", "M", "what a tick of a wheel is worth, metres"),
))
_FITTING = Group("fitting", (
    Option("lengths_m", "M,M,...", "lengths of the segments compared, metres (default: five)", metres),
    Option("positions_only", "", "do not use the truth's headings (default: if they are measured)"),
    Option("parameters", "NAME,NAME,...", "rates to fit, by the names of OdometryNoise (default: eight)", names),
    Option("time_offset_s", "S", "truth clock minus odometry clock, seconds (default: estimated)"),
    Option("heading_offset_deg", "DEG", "measured true heading minus the robot's, by mounting, degrees (default: "
           "estimated)"),
    Option("max_gap_s", "S", "longest gap of the truth to bridge, seconds"),
    Option("accept_faults", "", "answer and write files although the fit did not converge, sits on a bound, or the "
           "truth seems to be another drive's"),
    Option("confidence", "P", "confidence of the intervals", default=0.95),
    Option("seed", "N", "seed of the bootstrap", int, 0),
))
_MESSAGES = Group("messages of ROS, with --ros", (
    Option("speed", "M/S", "usual speed of the robot, metres per second"),
    Option("message_rate_hz", "HZ", "odometry messages per second", default=30.0),
))
COMMAND = Command(
    summary="the noise of an odometry from recorded drives and their truth",
    description="Fit the systematic and the random errors of an odometry to recorded drives whose truth is known, "
    "with intervals, and say how well the fit predicts. Files: TUM, KITTI, MR.CLAM, ROS bags and exports of topics, "
    "CARMEN, g2o, CSV with named columns and units in brackets, MATLAB 5; gzipped if they end in .gz.",
    run=run,
    arguments=(
        Option("files", "ODOM TRUTH", "odometry and truth of each drive, in turn: ODOM TRUTH ODOM TRUTH ...",
               input_file, how={"nargs": "+"}),
    ),
    groups=(Group("", _DRIVES), _READING, _FITTING, _MESSAGES),
    files={
        "yaml": "write the fitted noise, with its intervals",
        "ros": "write the covariances for nav_msgs/Odometry and robot_localization that it means; needs --speed",
        "picture": "draw errors against length, measured and predicted",
    },
    examples=("odom.csv truth.csv --yaml noise.yaml --picture fit.png",
              "odom1.txt truth1.txt odom2.txt truth2.txt --check odom3.txt truth3.txt --json"),
)
