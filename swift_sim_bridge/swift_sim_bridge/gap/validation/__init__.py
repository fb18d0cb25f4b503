"""Accuracy of a diagnosis, and where its findings show.

holdout: errors before and after the repair, on parts of the flights that no fit has used
parts: the parts that fits use, and those that are held out
black_boxes: black-box models, alone and of what a repair leaves
prediction_errors: errors of all these models on parts of recordings
repair_trials: effects and equations, fitted to one part of each flight and judged on another
repair_choice: what the repaired vehicle file gets
flight_regimes: times, segments between gates and flight regimes in which a gain shows
localization: by how much a finding lowers the error, in which channels, and where
mismatch: difference of recording and simulation over time, by layer
experiment_design: manoeuvres that separate confounders
"""
