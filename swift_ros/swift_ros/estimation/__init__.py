"""State estimation: visual-inertial odometry corrected by gate observations.

settings              settings of the estimator
vio_guard             frames and validity of the odometry
agreement             whether samples of the odometry agree with each other and with the IMU
inertial_prediction   dead reckoning while the odometry is refused
assignment            data association of observed gates
repeated_views        what images of an unchanged view add
corner_filter         Kalman filter on the rays to corners
drift_filter          the paper's Kalman filter on positions
calibration_evidence, podium_check, missing_gates
                      errors of the camera's calibration: in flight, before take-off, and of what is not seen
input_check           what the estimator refuses to take in
estimator             time order of odometry and images, and the state in the map
"""
