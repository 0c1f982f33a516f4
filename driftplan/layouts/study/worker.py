"""A worker process of a study: reads the shared inputs from a file and tasks from a pipe, and writes rows into it."""

from __future__ import annotations

import os
import pickle
import sys
from mmap import ACCESS_READ, mmap
from multiprocessing.connection import Connection
from queue import SimpleQueue
from threading import Thread
from typing import Any

from driftplan.layouts.study.work import Workshop


def _listen(link: Connection, inbox: SimpleQueue[Any]) -> None:
    """Take what comes; when the other end is gone so is the reason to go on, in the middle of a cell too."""
    while True:
        try:
            inbox.put(link.recv())
        except (EOFError, OSError):
            os._exit(0)


def main(descriptor: int, shared: int) -> None:
    """Work until the other end of the pipe is closed."""
    link, inbox = Connection(descriptor), SimpleQueue[Any]()
    Thread(target=_listen, args=(link, inbox), daemon=True).start()
    with mmap(shared, 0, access=ACCESS_READ) as content:
        workshop = Workshop(pickle.loads(content))
    while True:
        row = workshop.row(inbox.get())
        link.send(row)


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
