"""Routes of least drift: prices of motions, OMPL's planners and the project's own. The only wing that imports OMPL.

routes                          plan_route, Route
comparison                      compare_routes
cost                            the additive drift cost, its bracket, the geodesic bound

OMPL, for scripts of one's own
objective, motion_prices        DriftObjective, and the prices of single motions for its callbacks
spaces, curves, zone_lookup     which spaces can be priced, Dubins and Reeds-Shepp curves, zones one motion at a time
collision                       validity of states and motions over a World
ompl_paths, ompl_solve          the exact drift of OMPL's paths; one quiet run of an OMPL planner
roadmap                         RoadmapPlanner, with roadmap_spaces and roadmap_targets: what it plans in and for

The roadmap
roadmap_search, roadmap_growth  an anytime search, in batches
roadmap_graph, roadmap_pricing  nodes and edges; their prices in bulk
path_polish, exact_polish       shortcuts and small moves, by the additive and by the exact cost
exact_search, exact_roadmap     the least exact cost over a roadmap, with a proven bound;
exact_greedy                    a first path for it
exact_cost                      the exact expected squared drift of a path
"""
