"""The training of the gate detector.

settings      settings of the training, and its learning rate
validation    images on which the training is scored
progress      how far the training is, and its checkpoint
picture       curves of the training, and some validation images
job           what a training reads
pool          images that crops are cut from
train         the training: steps, checkpoints, export
"""
