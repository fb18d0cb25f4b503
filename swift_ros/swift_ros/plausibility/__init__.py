"""Whether the numbers of a file can belong to a real vehicle, track or camera.

finding: what a check finds. of_vehicle (with of_propulsion, of_motors, of_battery), of_track, of_camera: the checks;
they take the records of these files.
frames, shortest_way: the bars of gates, and the way through their openings.
"""
