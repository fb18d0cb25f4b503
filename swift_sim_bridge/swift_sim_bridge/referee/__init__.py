"""The referee of the gap tool: it evaluates the tool on sealed cases.

It conceals effects in flights of other simulators, publishes a hash of what it concealed, lets the tool diagnose the
recordings, and only then opens the answers and scores them.

The referee has its own second implementation of the physics, of the instruments and of the effects, on purpose: it
imports neither the tool nor the production simulator, so that an error of these cannot hide in the test. Only `runner`
calls the tool. (A test checks the imports.)

effects     sizes, how each is planted in a vehicle file, and the equation terms that describe it
simulator   the second implementation: vehicles, paths, pilot, physics, instruments; flights of RotorPy
families    what each family of cases conceals, and the seeds
concealment a vehicle with hidden effects
cases       one case: a family and a seed give a vehicle, a flight and hidden effects
plan        the cases of a batch
seal        the log with the hashes
runner      flies, seals, diagnoses, opens and scores each case
scoring     the score of one case
holdout     evaluation of the repaired vehicle file on another flight
records     the scores in the folder of a batch
summary     rates, targets and detection curves of many cases
tables, picture
            the summary as a table and as a figure
"""
