"""Recordings: bags, flight tables, and replay.

mcap_format/           MCAP files, sound or damaged; definitions of message types in them
table_formats/         rows of CSV and Parquet tables, sound or damaged
log_formats/           logs of other programs as topics and columns: PX4, ArduPilot, bags and tables of any kind
log_mapping/           which of their columns are which channel, in which unit and frame; physical checks
bags                   rosbag2 MCAP bags, read
bag_writer             the same, written so that they survive a crash
recovery               the readable rest of a damaged bag
writer                 received messages into a bag
checks                 detection of samples that cannot be measurements
flight_channels        channels of a flight table, their columns and units
flight_table           one flight in SI units
flight_checks          checks of a flight table
flight_bags            flight tables from bags
flight_files           flight tables from and to files
race_bag               result of a race from its bag
replay                 plan and order of a replay
comparison             comparison of a recording and its replay
replay_picture         figure of a replay
"""
