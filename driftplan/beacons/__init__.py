"""Beacons and what they do to the drift along a path.

beacon, passes, capture         BeaconKind, Beacon; where paths meet them; whether a robot that drifted still does
"""
