"""Numbers only: noise, error moments, drift. No maps, no OMPL, no beacons."""
