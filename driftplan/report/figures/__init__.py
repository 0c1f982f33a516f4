"""Figures: maps, routes, beacons and drift, drawn on the Axes or the Figure you hand in.

Numbers are computed apart from drawing, artists are returned, nothing is shown or saved, and no global setting of
matplotlib is touched. Everywhere ``ax`` is by default pyplot's current Axes, ``figure`` an empty one to draw into, by
default a new one that knows nothing of pyplot; further keywords go untouched to what the function is named after.

style                           colours, markers and line styles, once; panels, legends
maps                            worlds, routes with their error ellipses, beacons with their ranges
routes                          drift against distance, routes side by side or among beacons, chances of collision
layouts, fits                   layouts and co-designs, noise fits
sheet                           the installers' page A3
"""
