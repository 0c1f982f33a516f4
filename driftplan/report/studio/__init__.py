"""What stands behind the page of `driftplan.page` while Python runs.

answers     what the page cannot compute: the fewest beacons, routes, files
server      the page on the loopback address
widget      the page in a notebook
"""
