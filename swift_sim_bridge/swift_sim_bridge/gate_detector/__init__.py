"""The gate detector: its network, the images it learns from, its training and its evaluation.

model          the network and its loss
export         the network as an ONNX file
corner_states  visible, hidden, ignored
images         labelled images of all kinds, and what the network is to answer
scores         correct, wrong and missed corners
training       what it reads, image pool, steps, validation, checkpoints, picture
evaluation     recall and precision in held-out images, rendered or of a user
"""
