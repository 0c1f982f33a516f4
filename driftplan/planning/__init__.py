"""Routes of least drift: prices of motions, OMPL's planners and the project's own. The only wing that imports OMPL.

routes, request, status         plan_route, Route; what is asked, checked once; why a search ended
unaided                         paths for robots that read nothing on the way
many_routes                     plan_routes, on a graph that is kept with the world
comparison                      compare_routes, pareto_routes
collision_chance                how likely the drifting robot touches a wall
graph_routes                    the way of least drift on a route graph of nav2's
cost, bounds                    the additive drift cost, its bracket; what no route can do better
taut_strings                    what no route among the obstacles can do better, and a first route
roadmap                         the roadmap: growing, pricing, searching, polishing, with beacons or without
ompl                            OMPL, for scripts of one's own; RoadmapPlanner
"""
