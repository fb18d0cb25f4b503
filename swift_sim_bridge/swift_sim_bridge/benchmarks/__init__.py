"""Benchmarks of `swiftros bench` and `swiftros evaluate`.

kernels                  CPU time of renderer, gate detector and simulated tick
real_time                latency and load of the onboard nodes in real time
race_player              replays odometry and service calls of a recorded race
physics_speed            speed of the physics
physics_rivals           speed of other simulators
training_speed           speed of the policy's training
estimate_errors          errors of the state estimate in recorded flights
command_delay            time from a state to its command in force, in recorded flights
vehicle_figures          operating points and races compared with the paper's vehicle
firmware_sequences       inputs for simulated and real firmware
firmware_runs            runs of the real firmware
against_firmware         motor commands of the simulated and the real firmware
unseen_flights           a diagnosis tested on other flights, beside black-box models
unseen_flights_picture   picture of its errors
"""
