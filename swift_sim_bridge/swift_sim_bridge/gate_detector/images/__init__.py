"""Images for the gate detector: where they come from and their labels.

targets     labels of an image, and what the network is to answer
rendered    rendered scenes with random tracks and clutter
race_poses  random tracks and camera poses for them
labelled    folders of labelled images
composites  the composer of synthetic images of gates of many looks
composed    its images, through random lenses
sources     several of these, mixed
"""
