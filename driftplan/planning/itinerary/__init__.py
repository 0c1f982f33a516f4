"""Routes that use beacons so that the drift never exceeds a limit, or is least.

itinerary                       plan_itinerary, Itinerary
pareto                          pareto_routes: length against drift
roadmap_planner                 RoadmapPlanner, with beacons or without
reasons                         why no route keeps a limit, in words

How the search goes: `nodes` makes a roadmap, `beacon_roadmap` says what driving its edges does to the drift, `labels`
searches it, `search` asks until `check`, the exact model, agrees; `course` is that model, fast, for `shortening`;
`bounds` says what no route can do better.
"""
