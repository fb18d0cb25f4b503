"""State estimation: visual-inertial odometry corrected by gate observations.

settings         settings of the estimator
vio_guard        frames and validity of the odometry
assignment       data association of observed gates
corner_filter    Kalman filter on the rays to corners
drift_filter     the paper's Kalman filter on positions
estimator        time order of odometry and images, and the state in the map
"""
