"""Betaflight's rate loop with its mixer, compiled with JAX and batchable.

filters: PT1 to PT3, biquad and notch filters.
rpm_filter: notches at the harmonics of the rotors.
dynamic_notch: notches that follow the strongest vibrations.
stick_path: receiver frames to setpoints.
throttle_path: throttle to the mixer's throttle, gains and cutoffs.
runaway: runaway-takeoff prevention.
mixer: axis demands and throttle to motor commands.
profile: gains and coefficients of the loop.
loop: one pass of the loop.
substeps: passes of the loop within a step of the physics.
"""
