"""Numbers only: noise, error moments, drift. No maps, no OMPL, no beacons.

noise, presets, heading_laws    how one metre and one radian of odometry go wrong
paths                           what the robot drives: turns on the spot and runs
moments, elements               the error-moment algebra, and what a run and a turn are in it
readings, drive                 a fix, what it makes of the errors; the engine that carries them along a path
drift, point_drift              predict_drift; what is asked of a drift at points
worst, scores                   the greatest drift on the way; radii and probabilities
covariance, filter_state, fusion  the same for a robot that fuses its readings in a Kalman filter
simulation                      Monte Carlo dead reckoning, with resets or a real filter: the oracle
spatial                         the same in space
calibration                     noise from recorded drives
"""
