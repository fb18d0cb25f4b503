"""The camera.

model            fisheye projection, mount, and config/camera.yaml
picture          an image with its age, in the format of the camera
t265             RealSense T265
sources          devices, video files and image folders
mounts           mounts with exchanged axes or signs
projected_gates  the gates of a map in the image
"""
