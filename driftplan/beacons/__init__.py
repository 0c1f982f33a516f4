"""Beacons and what they do to the drift along a path.

beacon        BeaconKind, Beacon
beacon_files  beacons in files: load_beacons
tag_files     beacons as tags of ROS's detectors, static transforms
passes        where paths come into their range and sight
readings      what a robot reads on its way, the drift with it, and the chance that it gets to read it
"""
