"""Noise as YAML: what a fit found, kept where scenarios, scripts and people can read it."""

from __future__ import annotations

import os
from dataclasses import fields
from pathlib import Path
from reprlib import repr as short
from typing import Any

import numpy as np

from driftplan.errors import TrajectoryError, naming
from driftplan.files import head, write_files
from driftplan.model.calibration.fit import NoiseFit
from driftplan.model.noise import OdometryNoise
from driftplan.world.plain_data import read_yaml

_KEYS = tuple(f.name for f in fields(OdometryNoise))
_MAX_BYTES = 1 << 20


def save_noise(path: str | os.PathLike[str], noise: OdometryNoise | NoiseFit) -> None:
    """Write a noise, or a fitted one with its intervals as comments, under the names of `OdometryNoise`.

    Examples
    --------
    >>> import tempfile
    >>> noise = OdometryNoise(heading_var_per_m=1e-4, distance_scale_error=-0.01)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     save_noise(Path(folder) / "noise.yaml", noise)
    ...     load_noise(Path(folder) / "noise.yaml") == noise
    True
    """
    write_files({Path(path): noise_yaml(noise)})


def noise_yaml(noise: OdometryNoise | NoiseFit) -> bytes:
    """What `save_noise` writes."""
    lines = [f"{head('of the robot')}# Noise of an odometry for driftplan, in SI units and radians."]
    if isinstance(noise, NoiseFit):
        counts = noise.counts
        lines += [
            f"# Fitted to {counts.used_m:.1f} m of drives ({counts.turned_rad:.1f} rad turned); brackets:",
            f"# {100 * noise.confidence:g} % intervals.",
            *(f"# {note}" for note in noise.notes),
        ]
        for name, (low, high) in noise.intervals.items():
            lines.append(f"{name}: {_yaml(getattr(noise.noise, name))}  # [{low:.3g}, {high:.3g}]")
        lines += [f"{name}: {_yaml(value)}  # from drive to drive" for name, value in noise.between_drives.items()]
    else:
        for f in fields(noise):
            value = getattr(noise, f.name)
            if value != f.default:
                lines.append(f"{f.name}: {_yaml(value)}")
        if len(lines) == 1:
            lines.append("{}")
    return ("\n".join(lines) + "\n").encode()


def load_noise(path: str | os.PathLike[str]) -> OdometryNoise:
    """Read a noise from YAML: keys are the names of `OdometryNoise`, what is missing has its default.

    Raises
    ------
    TrajectoryError
        If the file is missing or broken, has unknown keys or values out of range: the message names file and key.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     _ = Path(folder, "noise.yaml").write_text("heading_var_per_m: 1e-4\\n")
    ...     load_noise(Path(folder, "noise.yaml"))
    OdometryNoise(heading_var_per_m=0.0001)
    """
    file = Path(path)
    content = read_yaml(file, TrajectoryError, max_bytes=_MAX_BYTES)
    if not isinstance(content, dict):
        raise TrajectoryError(
            f"{file}: expected keys of OdometryNoise, such as heading_var_per_m: 1.0e-4, got {short(content)}"
        )
    unknown = [key for key in content if key not in _KEYS]
    if unknown:
        raise TrajectoryError(f"{file}: unknown key {short(unknown[0])}; expected keys of {', '.join(_KEYS)}")
    with naming(file, TrajectoryError):
        return OdometryNoise(**content)


def _yaml(value: Any) -> str:
    """A scalar that YAML reads back as the same value: floats always have a point, or YAML 1.1 takes 1e-4 for text."""
    if not isinstance(value, float):
        return str(value)
    text = repr(float(np.float64(value)))
    return text if "." in text else text.replace("e", ".0e")
