"""All conversions between ROS messages and the data types of the cores.

`to_...` makes a message, `from_...` reads one.

serialization   messages of any type as CDR bytes
stamps          stamps as integer nanoseconds
vectors         vectors, attitudes and poses
motion          odometry, IMU
camera          images, the camera's model
gates           corners and poses of gates, corrections of the state
control         commands, the flight controller's link, rotors and battery
race            status of the race, markers of the track
"""
