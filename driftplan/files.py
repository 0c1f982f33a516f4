"""Files: those of others read within bounds, those for others written whole or not at all."""

from __future__ import annotations

import gzip
import os
import platform
import re
import shutil
import stat
import tempfile
import zlib
from collections.abc import Mapping
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Any

from driftplan.errors import MapError, StudyError, TrajectoryError, naming

FileError = type[MapError] | type[TrajectoryError] | type[StudyError]

MAX_BYTES = 256 << 20  # unpacked: a recording of a million steps takes a quarter of it
MAX_LINES = 2_000_000
VERSION = 1  # of the files that are written
_ROUNDING = 1e-15  # relative: of a few operations
_DESCRIPTOR = re.compile(r"/dev/(?:fd/(\d+)|std(in|out|err))")


def read_bytes(path: Path, error: FileError, *, max_bytes: int = MAX_BYTES) -> bytes:
    """The content of a regular file, or of a stream that was asked for by its number (``/dev/fd/63``); unpacked if its
    name ends in ``.gz``. A pipe or device of another name, which might never end, and more than ``max_bytes`` are an
    ``error``."""
    with naming(path, error):
        with open(path, "rb", opener=_without_waiting) as file:
            if not stat.S_ISREG(os.fstat(file.fileno()).st_mode) and _descriptor(path) is None:
                raise ValueError("expected a regular file, got a pipe or device")
            os.set_blocking(file.fileno(), True)
            try:
                packed = path.suffix.lower() == ".gz"
                content = (gzip.GzipFile(fileobj=file) if packed else file).read(max_bytes + 1)
            except (gzip.BadGzipFile, zlib.error, EOFError) as err:
                raise ValueError(f"broken gzip file ({err})") from err
        if len(content) > max_bytes:
            raise ValueError(f"expected at most {max_bytes} bytes{' unpacked' * packed}, got more")
    return content


def read_lines(path: Path, error: FileError, *, max_bytes: int = MAX_BYTES) -> list[str]:
    """The lines of a text, UTF-8 or with the mark of UTF-16, without their ends; bounded like `read_bytes`."""
    content = read_bytes(path, error, max_bytes=max_bytes)
    with naming(path, error):
        if content.count(b"\n") + content.count(b"\r") > MAX_LINES:
            raise ValueError(f"expected at most {MAX_LINES} lines, got more")
        try:
            text = content.decode("utf-16" if content[:2] in (b"\xff\xfe", b"\xfe\xff") else "utf-8-sig")
        except UnicodeDecodeError as err:
            raise ValueError(f"expected text, found binary data at byte {err.start}") from None
        if "\0" in text[:4096]:
            raise ValueError("expected text, found binary data")
    return text.replace("\r\n", "\n").replace("\r", "\n").removesuffix("\n").split("\n")


def write_files(files: Mapping[Path, bytes]) -> None:
    """Write all files under temporary names, then rename them: whatever interrupts, none is half written.

    A link stays a link, and the file it leads to is written; a file keeps its mode. What is no regular file (a device,
    a pipe, ``/dev/stdout``) is written into, never replaced.

    Raises ValueError if two of the names stand for one file, OSError if something cannot be written; a pipe that nobody
    reads from is among that.
    """
    targets: dict[Path, Path] = {}
    for path in files:
        target = path if _descriptor(path) is not None else path.resolve()
        if target in targets:
            raise ValueError(f"expected every file under a name of its own, got {path} and {targets[target]}")
        targets[target] = path
    streams = [target for target in targets if _descriptor(target) is not None or _is_no_file(target)]
    with ExitStack() as folders:
        parts: dict[Path, Path] = {}
        for target in (target for target in targets if target not in streams):
            _clean(target.parent)
            try:  # a folder of mkdtemp's did not exist, and is open to nobody else: no link can wait in it
                folder = tempfile.mkdtemp(prefix=_prefix(os.getpid()), dir=target.parent)
                folders.callback(shutil.rmtree, folder, ignore_errors=True)
                part = Path(folder, target.name)
                part.write_bytes(files[targets[target]])
                _keep_mode(part, target)
            except OSError as err:
                raise OSError(err.errno, err.strerror or str(err), str(targets[target])) from err
            parts[part] = target
        for target in streams:
            number = _descriptor(target)
            with open(target if number is None else os.dup(number), "wb", opener=_without_waiting) as stream:
                os.set_blocking(stream.fileno(), True)
                stream.write(files[targets[target]])
        for part, target in parts.items():
            part.replace(target)


def head(frame: str) -> str:
    """The comment that a text begins with: its version, and the frame of what stands in it."""
    return f"# driftplan file version {VERSION}, frame {frame}, metres\n"


def plain_numbers(value: Any) -> Any:
    """The same lists and objects for JSON, with 9.600000000000001 as people write it: numbers that rounding made of
    one with twelve digits are that one again.

    >>> plain_numbers({"x": [0.1 + 0.2, 1 / 3]})
    {'x': [0.3, 0.3333333333333333]}
    """
    if isinstance(value, Mapping):
        return {key: plain_numbers(inner) for key, inner in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain_numbers(inner) for inner in value]
    if isinstance(value, float):
        few = float(f"{value:.12g}")
        return few if abs(few - value) <= _ROUNDING * abs(value) else value
    return value


def _without_waiting(path: str, flags: int) -> int:
    """Opened at once: a pipe without another end would wait for ever."""
    return os.open(path, (flags & ~os.O_TRUNC) | os.O_NONBLOCK)


def _descriptor(path: Path) -> int | None:
    """The number of the open stream that a path stands for."""
    match = _DESCRIPTOR.fullmatch(os.fspath(path))
    return None if match is None else int(match[1] or ("in", "out", "err").index(match[2]))


def _keep_mode(part: Path, target: Path) -> None:
    if target.exists():
        old = target.stat()
        with suppress(PermissionError):  # somebody else's file becomes that of who overwrites it
            os.chown(part, old.st_uid, old.st_gid)
        part.chmod(stat.S_IMODE(old.st_mode))


def _is_no_file(path: Path) -> bool:
    return path.exists() and not (path.is_file() or path.is_dir())


def _prefix(process: int | str) -> str:
    return f".driftplan-{platform.node()}-{process}-"


def _clean(folder: Path) -> None:
    """Remove what processes of this machine that are no more have left behind."""
    for left in folder.glob(f"{_prefix('*')}*"):
        process = left.name.removeprefix(_prefix("")[:-1]).partition("-")[0]
        with suppress(PermissionError):
            try:
                os.kill(int(process), 0)
            except (ProcessLookupError, ValueError, OverflowError):
                shutil.rmtree(left, ignore_errors=True)
