"""From the topics and columns of a log to the channels of a flight table. No ROS.

quantities       units, frames and sizes of the channels
mapping          a mapping: which columns are a channel, in which unit and frame
mapping_file     its YAML file
conversion       channels in SI units and this project's frames
guess            the mapping of a log without a file
guess_px4, guess_ardupilot, guess_ros, guess_columns    the same for each kind of log
contradictions   physical checks of units and frames, and the line of the mapping that cures a contradiction
mistakes         the usual mistakes that those checks try
increments       what those checks compare: changes over short windows
motor_order      the place and spin of each motor, from commands and gyro
reading          all of it
"""
