"""What a limit demands of a layout, and the cheapest layout that gives it: the core of `driftplan.layouts.place`.

problem                         sites, costs, demands and caps, as the core wants them; the cheapest cover for a
                                limit, and the least limit that has one
placement_diagnosis             why there is no layout, in words

How the search goes: `route_table` turns routes into arrays of segments and possible readings; `requirements` says what
a limit demands of a layout, with `exclusions` (sets of sites that will not do) and `drives` (how far one gets from
reading to reading, and where given layouts break the limit, also with beacons dead).
For a robot that fuses its readings `fused_routes`, `fused_requirements` and `weighted_cuts` take the place of all
these. `covering` finds the cheapest cover of what is demanded, on plain arrays: `cut_pool` holds the cuts,
`cover_bounds` bounds the cost and looks for cheaper layouts.
"""
