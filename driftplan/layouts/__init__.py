"""Layouts: where to put the fewest beacons, and beacons and routes chosen together. Imports go down this list:

co_design                       beacons and routes chosen together
layout_files                    layouts as files
layout_comparison               compare_layouts: layouts side by side
place                           place_beacons, beacon_tradeoff: the search for the fewest
layout                          Layout: what placing answers
placement                       what a limit demands of a layout, and the cheapest cover of that
scenario, sites, site_grids     what is asked: routes and limit; where beacons may go; points of grids and walls
"""
