"""Perception: gates in images, and their poses relative to the vehicle.

upright            panorama in which gravity points down
corner_network     network that finds corners and edges in the panorama
corner_grouping    corners and edges to gates
incomplete_gates   the same for gates of which two or three corners are seen
gate_detector      image and attitude to the corners of gates
mount_search       gates on the podium with a wrong mount
settings           settings of the detector
gate_pose          corners of a gate to its pose
"""
