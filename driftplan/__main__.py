"""``python -m driftplan``: the driftplan command."""

import sys

from driftplan.report.cli import main

sys.exit(main())
