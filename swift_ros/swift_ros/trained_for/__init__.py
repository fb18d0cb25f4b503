"""What the networks were trained for, and how the files that they are to fly with differ from it.

The provenance beside a network (MODEL.json) holds the track, the vehicle or the camera of its training under
`trained_for`, in the form of their files. A difference is a warning: it changes nothing in a flight.

comparison  the provenance of a network, and sentences on differences
pilot       track and vehicle
detector    camera, gates and looks
folder      a whole configuration folder
"""
