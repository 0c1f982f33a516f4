"""Beacons and what they do to the drift along a path.

beacon        BeaconKind, Beacon
beacon_files  beacons in files: GeoJSON, tags of ROS's detectors, static transforms, fleets
passes        where paths come into their range and sight
readings      what a robot reads on its way, the drift with it, and the chance that it gets to read it
"""
