"""The project's own roadmap of a world.

growth                          an anytime search for a robot that reads nothing, in batches
kept_graph                      a first route, from triangle to triangle; a graph of a world that all queries share
graph, prices                   nodes, edges and where nodes may lie; their prices in bulk
polish                          shortcuts and small moves of waypoints; shortening
beacon_graph, edge_steps        what driving an edge does to the drift, beacons on the way included
reset_edges, fused_edges        the errors on the edges by the estimator, and which labels dominate which
label_search                    the search for walks whose drift depends on what was read: labels, dominance
beacon_walks, beacon_search     walks that the exact model agrees with; questions about the best path among beacons
itinerary_check                 the exact model of drift along a path among beacons; why none keeps a limit, in words
beacon_growth                   the same on ever larger roadmaps, for `RoadmapPlanner`
"""
