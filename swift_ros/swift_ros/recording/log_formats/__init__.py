"""The logs of other programs as topics of named columns, sound or damaged; what they mean is for `log_mapping`. No ROS.

log            what a log holds
sound_spans    the sound parts of a log of framed messages, and what lies between them
ulog           PX4 ULog
dataflash      ArduPilot DataFlash, binary and text
ros_bags       rosbag2 MCAP bags of any graph, by the definitions that they store
other_bags     SQLite bags of ROS 2, and bags of ROS 1
ros_messages   messages of ROS as columns of numbers
tables         CSV and Parquet tables of any columns
"""
