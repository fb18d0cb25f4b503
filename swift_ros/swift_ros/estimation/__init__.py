"""State estimation: visual-inertial odometry corrected by gate observations.

settings              settings of the estimator
odometry_check        frames and validity of the odometry, in the node vio
inertial_velocity     velocity of the odometry, smoothed by the accelerometer
velocity_path         path of the odometry as the integral of this velocity
assignment            data association of observed gates
repeated_views        what images of an unchanged view add
corner_filter         Kalman filter on the rays to corners
drift_filter          the paper's Kalman filter on positions
calibration_evidence, podium_check, missing_gates
                      errors of the camera's calibration: in flight, before take-off, and of what is not seen
input_check           what the estimator refuses to take in
estimator             time order of odometry and images, and the state in the map
"""
