"""Black-box models of residual accelerations, as baselines and as learned residual physics.

nearest_neighbors: the mean of the nearest samples, as in the paper
gaussian_process: Gaussian-process regression
"""
