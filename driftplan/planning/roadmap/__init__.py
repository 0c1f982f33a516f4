"""The project's own roadmap of a world.

search, growth                  an anytime search, in batches
graph, prices                   nodes and edges; their prices in bulk
polish, exact_polish            shortcuts and small moves, by the additive and by the exact cost
exact_search, exact_roadmap     the least exact cost over a roadmap, with a proven bound;
exact_greedy                    a first path for it
exact_cost                      the exact expected squared drift of a path
"""
