"""The gap tool: which physics does a simulation lack, given recordings of flights and a vehicle file?

`api.diagnose` is the whole tool as one function. The packages, in the order of the pipeline; each imports only those
above it:

effects       the catalogue: each effect is a change of the vehicle file with unknown parameters
recording     recordings on common times, checked for contradictions between channels; commands as the rate loop
              received them; gates in images, associated with the gates of the map
residuals     measured minus simulated values with measured inputs, by layer: command, motor, force, moment, imu, vio,
              camera
inference     sensitivities of the residuals to each effect, normal equations, null distribution, stepwise selection
nominal       reference flights: the vehicle as its file describes it, along the recorded path, measured by the same
              instruments; their residuals give the null distribution
discovery     equation search: sparse regression of residuals that no effect explains on physical quantities
attribution   the search: effects that the evidence calls for, their joint estimates, and their comparison with
              equations
validation    errors on parts of the flights that no fit has used; where each finding is visible; the manoeuvre that
              separates confounders
report        report.json, the text in the terminal, the HTML page with its figures, the repaired vehicle file
pipeline      the diagnosis of one recording, and of several together
api           `diagnose`
self_test     test of the installation: nominal flights and planted effects
"""
