"""Beacons and routes chosen together.

co_design       the search
design_problem  its two halves: beacons for routes, routes among beacons
design          what it answers
trips           what is driven, in Python or from a file
"""
