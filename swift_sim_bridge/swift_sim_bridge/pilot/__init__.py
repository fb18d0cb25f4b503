"""The pilot: training and evaluation of the policy by reinforcement learning, all races as one batch of arrays.

episodes        start, step, rules and reward of n races
networks        actor and critic
settings        settings of the training and their schedules
learner         what changes during a training, its first state, the optimizer
ppo             proximal policy optimisation
backpropagation descent on the exact gradient of whole races
compiled        updates of either on all devices
trial           whole races with the deterministic policy
robustness      what a pilot withstands
export          the policy as an ONNX file
picture         curves of a training, and the lines of its last trial
job             what a training reads, what it was before, the state from which it goes on
train           the training around the algorithm: trials, checkpoints, log, export
"""
