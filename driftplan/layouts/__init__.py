"""Layouts: where to put the fewest beacons, and beacons and routes chosen together.

placement                       place_beacons: the fewest that keep a limit
layout, layout_files            Layout: what placing answers, and its files
co_design                       beacons and routes chosen together
"""
