"""Pictures, and the driftplan command. This wing may import everything; nothing imports it.

cli, cli_commands               the command; demo, predict, plan, compare, maps
cli_options, cli_output         options that subcommands share; tables, JSON, files
place_command, design_command, fit_command, itinerary_options, demo_beacons
                                the other subcommands, and parts of them
plotting, ellipses              maps, routes, error ellipses, drift against distance
plot_beacons, plot_itinerary, plot_design, plot_fit
                                figures of layouts, itineraries, designs, fits
"""
