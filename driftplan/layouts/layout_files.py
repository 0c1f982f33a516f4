"""Layouts as files: GeoJSON whose beacons driftplan reads back, and a table for whoever installs them."""

from __future__ import annotations

import csv
import io
from math import isfinite
from typing import Any

from driftplan.beacons.beacon_files import beacon_feature
from driftplan.layouts.layout import InstallerRow, Layout, installer_table
from driftplan.world.geojson_map import feature_collection


def layout_csv(layout: Layout) -> bytes:
    """The installers' table as CSV, to a tenth of a millimetre, with a header that names units.

    Numbers of routes are separated by spaces; a cell without a number is empty.
    """
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(InstallerRow._fields)
    for row in installer_table(layout):
        writer.writerow([_cell(value) for value in row])
    return text.getvalue().encode()


def _cell(value: Any) -> Any:
    if isinstance(value, tuple):
        return " ".join(map(str, value))
    if isinstance(value, float):
        return round(value, 4) if isfinite(value) else ""
    return value


def layout_geojson(layout: Layout) -> bytes:
    """Beacons as points with all that `load_beacons` needs, and what their failure does."""
    features = [
        beacon_feature(beacon, new=beacon in layout.beacons, routes=routes, worst_drift_if_dead_m=said)
        for beacon, routes, worst, _ in layout.importance
        for said in [round(worst, 6) if routes else None]
    ]
    summary = {name: getattr(layout, name) for name in ("cost", "lower_bound", "proven")}
    worst_m = round(layout.worst_drift, 6)
    return feature_collection(features, driftplan={"version": 1, **summary, "worst_drift_m": worst_m})
