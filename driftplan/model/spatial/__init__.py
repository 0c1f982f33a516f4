"""Drift in space.

drift           predict_drift_3d, predict_flight_drift
steps           motions as odometry sees them: a rotation and a translation each
rotations       RotationNoise: how one attitude increment goes wrong
moments         the error-moment algebra in space
simulation      Monte Carlo, the oracle
"""
