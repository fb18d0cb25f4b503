"""What `swiftros view` shows, as a recording of the Rerun viewer: flights, gap reports, trainings.

rows       what is shown at one time, and the stream that it is written to
scene      track, vehicle, poses, paths and images as Rerun archetypes
series     commands, measurements and states as values of curves
flight     the messages of a flight, topic by topic, as rows
layout     the panels: blueprints of the viewer
bag        a recorded flight
live       the running graph
gap        the folder of a gap report
training   the folder of a training
sources    what a path holds
viewer     the viewer: a window, a page in the browser, or a file
foxglove   the same panels as a layout of Foxglove; needs no Rerun
"""
