"""``driftplan fit``: the noise of an odometry from recorded drives, checked on others."""

from __future__ import annotations

import argparse
import sys
from math import radians
from pathlib import Path
from typing import TYPE_CHECKING, Any

from driftplan.files import write_files
from driftplan.report import cli_output as output
from driftplan.report.cli_options import noise_as_json, output_file, png_file

if TYPE_CHECKING:
    from driftplan.model.calibration.fit import NoiseFit
    from driftplan.model.calibration.recordings import OdometryLog, Trajectory
    from driftplan.model.calibration.relative_errors import RelativeErrors
    from driftplan.model.calibration.segment_check import SegmentCheck

    Drive = tuple[OdometryLog, Trajectory]

_KINDS = ("increments", "velocities", "poses")


def add_parser(subparsers: Any) -> argparse.ArgumentParser:
    """Add the subcommand; `fit` carries it out."""
    parser: argparse.ArgumentParser = subparsers.add_parser(
        "fit",
        help="the noise of an odometry from recorded drives and their truth",
        description="Fit the systematic and the random errors of an odometry to recorded drives whose truth is known, "
        "with intervals, and say how well the fit predicts. Files: TUM, KITTI, MR.CLAM, CSV with named columns, MATLAB "
        "5; gzipped if they end in .gz.",
    )
    parser.add_argument(
        "files",
        nargs="+",
        metavar="ODOM TRUTH",
        help="odometry and truth of each drive, in turn: ODOM TRUTH ODOM TRUTH ...",
    )
    parser.add_argument(
        "--check",
        nargs="+",
        default=[],
        metavar="FILE",
        help="drives to check the fit on, ODOM TRUTH ODOM TRUTH ..., that are not fitted",
    )
    parser.add_argument(
        "--check-from",
        type=float,
        metavar="SHARE",
        help="fit the drives up to this share of their time (0 to 1), check on the rest",
    )
    reading = parser.add_argument_group("what the files hold")
    reading.add_argument(
        "--odometry-kind",
        choices=_KINDS,
        help="increments: time, distance, turn; velocities: time, forward speed, turn rate; poses (default: as the "
        "columns' names or number say)",
    )
    for which in ("odometry", "truth"):
        reading.add_argument(
            f"--{which}-columns",
            metavar="NAME,NAME,...",
            help=f"columns of the {which}: time, distance, turn, speed, turn_rate, x, y, heading, qx, qy, qz, qw; any "
            "other name is skipped",
        )
        reading.add_argument(f"--{which}-variable", metavar="NAME", help=f"variable of a MATLAB file with the {which}")
    reading.add_argument(
        "--rate-hz", type=float, default=10.0, metavar="HZ", help="poses per second of KITTI files (default: 10)"
    )
    fitting = parser.add_argument_group("fitting")
    fitting.add_argument(
        "--lengths-m", type=_numbers, metavar="M,M,...", help="lengths of the segments compared, metres (default: five)"
    )
    fitting.add_argument(
        "--positions-only", action="store_true", help="do not use the truth's headings (default: if they are measured)"
    )
    fitting.add_argument(
        "--parameters", metavar="NAME,NAME,...", help="rates to fit, by the names of OdometryNoise (default: eight)"
    )
    fitting.add_argument(
        "--time-offset-s",
        type=float,
        metavar="S",
        help="truth clock minus odometry clock, seconds (default: estimated)",
    )
    fitting.add_argument(
        "--heading-offset-deg",
        type=float,
        metavar="DEG",
        help="measured true heading minus the robot's, by mounting, degrees (default: estimated)",
    )
    fitting.add_argument("--max-gap-s", type=float, metavar="S", help="longest gap of the truth to bridge, seconds")
    fitting.add_argument(
        "--confidence", type=float, default=0.95, metavar="P", help="confidence of the intervals (default: 0.95)"
    )
    fitting.add_argument("--seed", type=int, default=0, metavar="N", help="seed of the bootstrap (default: 0)")
    files = parser.add_argument_group("files")
    files.add_argument("--yaml", type=output_file, metavar="FILE", help="write the fitted noise, with its intervals")
    files.add_argument(
        "--png", type=png_file, metavar="FILE", help="draw errors against length, measured and predicted"
    )
    parser.add_argument("--json", action="store_true", help="print JSON, every key with its unit")
    return parser


def fit(args: argparse.Namespace) -> None:
    """The noise of the drives that the arguments name."""
    from driftplan.model.calibration.fit import PARAMETERS, fit_noise
    from driftplan.world.noise_files import noise_yaml

    drives = list(_recorded(args, args.files).values())
    checked = {label: [drive] for label, drive in _recorded(args, args.check).items()}
    if args.check_from is not None:
        drives, rest = _split(drives, args.check_from)
        checked = {"the rest of the drives": rest, **checked}
    options: dict[str, Any] = {
        "use_heading": False if args.positions_only else None,
        "time_offset_s": args.time_offset_s,
        "heading_offset": None if args.heading_offset_deg is None else radians(args.heading_offset_deg),
        "max_gap_s": args.max_gap_s,
    }
    print(f"fitting {len(drives)} drive{'s' * (len(drives) > 1)}", file=sys.stderr, flush=True)
    found = fit_noise(
        [odometry for odometry, _ in drives],
        [truth for _, truth in drives],
        parameters=PARAMETERS if args.parameters is None else args.parameters.split(","),
        lengths_m=args.lengths_m,
        confidence=args.confidence,
        seed=args.seed,
        **options,
    )
    if not found.check.has_heading:
        options["use_heading"] = False
    checks = {
        label: found.check_on(
            [odometry for odometry, _ in some], [truth for _, truth in some], lengths_m=args.lengths_m, **options
        )
        for label, some in checked.items()
    }
    files = {}
    if args.yaml:
        files[args.yaml] = noise_yaml(found)
    if args.png:
        files[args.png] = _picture(found, checks)
    write_files(files)
    if args.json:
        print(output.json_text({"command": "fit", **_as_json(found, checks)}))
        return
    print(found)
    for label, check in checks.items():
        print(f"\nchecked on {label}:")
        print("\n".join([str(check), *check.notes]))


def _recorded(args: argparse.Namespace, files: list[str]) -> dict[str, Drive]:
    """Drives by the name of their odometry's file, as short as tells them apart."""
    from driftplan.world.odometry_logs import read_odometry, read_truth

    if len(files) % 2:
        raise ValueError(f"expected files in pairs, ODOM TRUTH ODOM TRUTH ..., got {len(files)}: {' '.join(files)}")
    short = [Path(odometry).name for odometry in files[::2]]
    names = short if len(set(short)) == len(short) else files[::2]
    return {
        name: (
            read_odometry(
                odometry,
                kind=args.odometry_kind,
                columns=_names(args.odometry_columns),
                variable=args.odometry_variable,
                rate_hz=args.rate_hz,
            ),
            read_truth(truth, columns=_names(args.truth_columns), variable=args.truth_variable, rate_hz=args.rate_hz),
        )
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


def _picture(found: NoiseFit, checks: dict[str, SegmentCheck]) -> bytes:
    from driftplan.report.plot_fit import plot_fit

    return output.figure_png(plot_fit(found, checks))


def _as_json(found: NoiseFit, checks: dict[str, SegmentCheck]) -> dict[str, Any]:
    counts = found.counts
    return {
        "noise": noise_as_json(found.noise),
        "confidence": found.confidence,
        "intervals": {name: list(interval) for name, interval in found.intervals.items()},
        "std_errors": found.std_errors,
        "truth_position_std_m": found.truth_position_std_m,
        "truth_heading_std_rad": found.truth_heading_std,
        "time_offsets_s": list(found.time_offsets_s),
        "heading_offsets_rad": list(found.heading_offsets),
        "recordings": {name: getattr(counts, name) for name in counts.__dataclass_fields__},
        "fit": _check_as_json(found.check),
        "held_out": _check_as_json(found.held_out),
        "relative_errors": None if found.relative_errors is None else _relative_as_json(found.relative_errors),
        "checks": {label: _check_as_json(check) for label, check in checks.items()},
        "notes": list(found.notes),
    }


def _check_as_json(check: SegmentCheck) -> dict[str, Any]:
    return {"lengths": [row._asdict() for row in check.lengths], "notes": list(check.notes)}


def _relative_as_json(errors: RelativeErrors) -> dict[str, Any]:
    return {
        "lengths": [row._asdict() for row in errors.lengths],
        "translation_percent": errors.translation_percent,
        "rotation_deg_per_m": errors.rotation_deg_per_m,
    }


def _names(text: str | None) -> list[str] | None:
    return None if text is None else [name.strip() for name in text.split(",")]


def _numbers(text: str) -> list[float]:
    try:
        return [float(part) for part in text.split(",")]
    except ValueError:
        raise argparse.ArgumentTypeError(f"expected lengths M,M,... in metres, got {text!r}") from None
