"""The project's own roadmap of a world.

search, growth                  an anytime search, in batches
graph, prices                   nodes and edges; their prices in bulk
polish                          shortcuts and small moves of waypoints
"""
