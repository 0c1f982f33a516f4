"""Reads many broken files in a process of little memory, and prints those that went wrong.

``python -m tests.fuzz.files SEED COUNT FOLDER`` reads COUNT files. A reader may give a value, or raise
what its docstring promises: a ValueError that names the file in one line, or an OSError, within 3 seconds of the
processor and a gigabyte of memory.
"""

from __future__ import annotations

import random
import resource
import signal
import sys
import tempfile
import traceback
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from tests.fuzz.mutations import mutated
from tests.fuzz.seeds import SEEDS, Seed

SECONDS = 3.0
MEMORY = 1 << 30


class Hang(BaseException):
    """A file took too long: not to be caught by what reads it."""


def fault_of(seed: Seed, content: bytes, folder: Path) -> str | None:
    """What went wrong with a file of this content, if anything did."""
    for name, beside in seed.beside.items():
        (folder / name).write_bytes(beside)
    file = folder / seed.name
    file.write_bytes(content)
    try:
        with limited(), warnings.catch_warnings():
            warnings.simplefilter("error")
            seed.read(str(file))
    except (ValueError, OSError) as err:
        if "\n" in str(err).strip() or file.stem not in str(err) or len(str(err)) > 1000:
            return f"a message that names no file, or has several lines: {str(err)[:300]!r}"
    except (Exception, Hang) as err:
        return f"{err!r} at {traceback.extract_tb(err.__traceback__)[-1]}"
    return None


@contextmanager
def limited(seconds: float = SECONDS) -> Iterator[None]:
    """What takes more than its seconds of the processor is a `Hang`."""
    signal.signal(signal.SIGPROF, _hang)
    signal.setitimer(signal.ITIMER_PROF, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)


def _hang(*_: object) -> None:
    raise Hang


def limit_memory() -> None:
    """A gigabyte more than there is now."""
    used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (used + MEMORY, used + MEMORY))


def main(seed: int, count: int, keep: Path) -> int:
    rng, faults = random.Random(seed), 0
    for known in SEEDS:  # warm: what is imported late needs memory of its own
        with tempfile.TemporaryDirectory() as folder:
            fault = fault_of(known, known.content, Path(folder))
            assert fault is None, (known.name, fault)
    limit_memory()
    for k in range(count):
        chosen = SEEDS[k % len(SEEDS)]
        content = mutated(chosen.content, rng, rng.choice(SEEDS).content)
        with tempfile.TemporaryDirectory() as folder:
            fault = fault_of(chosen, content, Path(folder))
        if fault is not None:
            faults += 1
            keep.mkdir(exist_ok=True)
            case = keep / f"{seed}-{k}-{chosen.name}"
            case.write_bytes(content)
            print(f"{case}: {fault}", flush=True)
    return faults > 0


if __name__ == "__main__":
    sys.exit(main(int(sys.argv[1]), int(sys.argv[2]), Path(sys.argv[3])))
