"""OMPL, for scripts of one's own: the objective, the planner, and what they need of OMPL's spaces.

objective, motion_prices        DriftObjective, and the prices of single motions for its callbacks
spaces, curves, zone_lookup     which spaces can be priced, Dubins and Reeds-Shepp curves, zones one motion at a time
collision                       validity of states and motions over a World
paths                           the exact drift of OMPL's paths; better paths near them
solve                           one quiet run of an OMPL planner; CostConvergence, when a planner may stop
roadmap_planner                 RoadmapPlanner; roadmap_problem: what it plans in and for
"""
