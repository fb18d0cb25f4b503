"""The gate detector: its training on rendered images, and its evaluation.

race_poses    random tracks and camera poses for training images
flown_poses   poses of recorded races for evaluation images
data          labelled images
model         the network and its loss
export        the network as an ONNX file
scores        correct, wrong and missed corners
settings      settings of the training, and its learning rate
validation    images on which the training is scored
progress      how far the training is, and its checkpoint
picture       curves of the training, and some validation images
train         the training: image pool, steps, checkpoints, export
setup         the detector as it flies, from a configuration folder
evaluate      recall and precision in held-out images
report        the result of an evaluation as table and pictures
"""
