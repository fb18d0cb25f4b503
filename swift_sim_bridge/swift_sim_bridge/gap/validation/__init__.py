"""Accuracy of a diagnosis, and where its findings show.

holdout: errors before and after the repair, on parts of the flights that no fit has used
parts: the parts that fits use, and those that are held out
black_boxes: black-box models, alone and of what a repair leaves
prediction_errors: errors of all these models on parts of recordings
trial: effects that are fitted to the first part of each flight
unseen_errors: their errors on the parts that the fit has not used
repair_trials: the judge, which tries names and equations
repair_choice: what the repaired vehicle file gets
flight_regimes: times, segments between gates and flight regimes in which a gain shows
localization: by how much a finding lowers the error, in which channels, and where
mismatch: difference of recording and simulation over time, by layer
experiment_design: manoeuvres that separate confounders
"""
