"""A race: its rules, its course and its result. No ROS.

rules     geometry of passage, margin, reach of the hull and flight volume
judge     poses in; passages, laps, the finish, a crash or a missed gate out
control   the course from idle to the end: arming, start, stop, faults
result    the result of a recorded race
"""
