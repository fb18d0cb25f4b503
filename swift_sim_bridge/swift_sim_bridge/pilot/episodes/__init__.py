"""The episodes of a training: `n` races side by side, as pure functions of arrays.

world           what stays the same in a training: track, vehicle, settings
time_optimal    the guide of a training: the time-optimal lap
starts          where episodes start: on the podium, or around a state behind a gate
randomization   what is drawn for each episode, and the errors of the state estimate
judging         passage, miss, touch and bounds, once a control tick
rewards         the reward as a sum of terms
environment     reset, observation and step
"""
