"""Layouts: where to put the fewest beacons, and beacons and routes chosen together. Imports go down this list:

study                           run_study: many scenarios, on all cores or a cluster
co_design                       beacons and routes chosen together
place                           place_beacons, beacon_tradeoff: the search for the fewest
layout, layout_files            Layout: what placing answers, and side by side; in files
placement                       what a limit demands of a layout, and the cheapest cover of that
scenario                        what is asked: routes and limit; where beacons may go
"""
