"""State estimation: visual-inertial odometry corrected by gate observations.

settings              settings of the estimator
odometry_check        frames and validity of the odometry, in the node vio
specific_force        integral of the accelerometer between two samples of the odometry
velocity_path         path of the odometry as the integral of its velocity
assignment            data association of observed gates
repeated_views        what images of an unchanged view add
corner_state, corner_motion, corner_filter
                      Kalman filter on the rays to corners, accelerometer and odometry: state, prediction, correction
drift_filter          the paper's Kalman filter on positions
calibration_evidence, podium_check, missing_gates
                      errors of the camera's calibration: in flight, before take-off, and of what is not seen
input_check           what the estimator refuses to take in
estimator             time order of odometry and images, and the state in the map
"""
