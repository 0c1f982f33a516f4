"""Routes of least drift: prices of motions, OMPL's planners and the project's own. The only wing that imports OMPL.

routes                          plan_route, Route
comparison                      compare_routes
cost                            the additive drift cost, its bracket, the geodesic bound
bounds                          what no route can do better
taut_strings                    what no route among the obstacles can do better, and a first route
plan                            plan_route as scripts know it, with beacons or without
roadmap                         the roadmap: growing, pricing, searching, polishing
ompl                            OMPL, for scripts of one's own
itinerary                       routes from beacon to beacon
"""
