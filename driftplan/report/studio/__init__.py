"""What stands behind the page of `driftplan.page` while Python runs.

answers     what the page cannot compute: the fewest beacons, routes; files that it does not read and write itself
server      the page on the loopback address
widget      the page in a notebook
"""
