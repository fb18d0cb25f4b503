"""The pilot: training and evaluation of the policy by reinforcement learning, all races as one batch of arrays.

world           what stays the same in a training: track, vehicle, settings
starts          where episodes start: on the podium, or around a state behind a gate
randomization   what is drawn for each episode, and the errors of the state estimate
judging         passage, miss, touch and bounds, once a control tick
rewards         the reward as a sum of terms
environment     reset, observation and step of n races
networks        actor and critic
settings        settings of the training and their schedules
algorithm       proximal policy optimisation
trial           whole races with the deterministic policy
export          the policy as an ONNX file
picture         curves of a training, and the lines of its last trial
job             what a training reads, what it was before, the state from which it goes on
train           the training around the algorithm: trials, checkpoints, log, export
"""
