"""Residuals: measured minus modelled signals, each layer with measured inputs, so that no error reaches the next layer.

channels            residual channels that a recording allows, in groups
filters             the low-pass filter that both sides of every equation pass
sensor_correction   measurements without the errors that the sensor terms describe
kinematics          what pose and gyro give about the motion, filtered
physics_replay      forces, moments and rotor speeds of vehicle variants with measured inputs
pack_replay         the battery under the load of its rotors, and the motors that it supplies
variants            vehicle variants that are compared with one recording
propulsion          rotor speeds, voltage and electrical power
rigid_body          specific force, angular acceleration, and the inertial sensors against the pose
camera              corners of gates in images
odometry            velocity of visual-inertial odometry
commands            commands at the rate loop, and the rate loop's demand
residual_model      all residuals of one recording for many variants
rollout             open-loop simulations from recorded states
"""
