"""Whether odometry is believed, in the node vio.

vio_guard             frames and validity of the odometry
agreement             whether its samples agree with each other and with the IMU
inertial_prediction   dead reckoning while it is refused
"""
