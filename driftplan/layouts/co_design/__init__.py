"""Beacons and routes chosen together.

co_design       the search
design_problem  its two halves: beacons for routes, routes among beacons
design          what it is asked and answers: trips and designs
"""
