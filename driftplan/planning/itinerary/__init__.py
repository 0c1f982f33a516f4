"""The exact model of drift along a path among beacons: check, and course, which it is fast by."""
