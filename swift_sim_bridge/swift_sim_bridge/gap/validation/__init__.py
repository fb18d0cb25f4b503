"""Accuracy of a diagnosis, and where its findings show.

holdout: errors before and after the repair, on parts of the flights that no fit has used
localization: times, segments between gates and flight regimes in which a finding shows
mismatch: difference of recording and simulation over time, by layer
experiment_design: manoeuvres that separate confounders
"""
