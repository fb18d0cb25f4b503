"""The gate detector: its network, the images it learns from, its training and its evaluation.

model         the network and its loss
export        the network as an ONNX file
data          labelled images, rendered
race_poses    random tracks and camera poses for them
scores        correct, wrong and missed corners
setup         the detector as it flies, from a configuration folder
training      image pool, steps, validation, checkpoints, picture
evaluation    recall and precision in held-out images, rendered or of a user
"""
