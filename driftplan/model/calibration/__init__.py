"""Noise from recorded odometry and truth.

fit                 fit_noise, NoiseFit
noise_check         check_noise: how well a noise predicts recorded drives
umbmark             systematic errors from squares driven both ways round
relative_errors     drift in % and deg/m, as benchmarks count it
recordings          what the odometry said, and where the robot was; simulate_log

How a fit goes: `matched_drive` puts odometry beside truth, `resampling` takes the drive at even knots, `segment_sets`
cuts drives into `segments` of several lengths, `quasi_likelihood` fits their errors' moments and tells how well they
are known and how drives differ, `noise_check` compares predicted with measured and with what chance does under a right
model, `notes` says in words what to know.
"""
