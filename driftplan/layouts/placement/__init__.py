"""The fewest, or cheapest, beacons that keep the drift of routes under a limit, proven.

place                           place_beacons, beacon_tradeoff
problem, candidates             what is asked, checked; where beacons could go
reasons                         why there is no layout, in words

How the search goes: `tracks` turns routes into arrays of pieces and possible readings; `requirements` says what a limit
demands of a layout, with `exclusions` (sets of sites that will not do), `hops` and `spans` (how far one gets from
reading to reading) and `drives` (where given layouts break the limit); `covering` finds the cheapest cover of what is
demanded, on plain arrays, with `cut_pool` and `highs`.
"""
