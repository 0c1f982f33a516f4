"""Beacons: what they do to the drift, where to put them, and routes that use them.

beacon, passes, capture         BeaconKind, Beacon; where paths meet them; whether a robot that drifted still does
placement                       place_beacons: the fewest that keep a limit
layout, layout_files            Layout: what placing answers, and its files
itinerary                       routes from beacon to beacon
co_design                       beacons and routes chosen together
plan                            plan_route as scripts know it, with beacons or without
"""
