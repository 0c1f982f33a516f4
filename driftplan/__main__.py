"""``python -m driftplan``, and what the installed command runs."""

import signal
import sys

if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
    signal.signal(signal.SIGINT, signal.SIG_DFL)  # while modules load there is nothing to tidy up, or to say

from driftplan.report.cli import main

if __name__ == "__main__":
    sys.exit(main())
