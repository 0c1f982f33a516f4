"""Figures, and the driftplan command. This wing may import everything; nothing imports it.

figures                         maps, routes, layouts, fits drawn
commands                        the subcommands, a file each
studio                          a page in the browser, or in a notebook, with Python behind it
cli                             parses, runs a subcommand, says in one line what went wrong
study_report                    the report of a study, one page
records                         drift as table, JSON, CSV, GeoJSON
"""
