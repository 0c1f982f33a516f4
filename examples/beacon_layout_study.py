"""A beacon layout study: what `beacon_layout_study.yaml` asks, answered on all cores; with a name, also as a report."""

import sys
import tempfile
from pathlib import Path

from driftplan import run_study, study_html

with tempfile.TemporaryDirectory() as folder:
    study = run_study(Path(__file__).with_suffix(".yaml"), "processes", results=Path(folder, "rows.jsonl"))
print("limits are on the rms drift\n", study.to_pandas()[["limit_m", "redundancy", "outcome", "beacons", "proven"]])
if len(sys.argv) > 1:
    Path(sys.argv[1]).write_bytes(study_html(study))
