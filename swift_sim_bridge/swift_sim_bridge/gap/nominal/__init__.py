"""Reference flights: Monte-Carlo flights of the vehicle as its file describes it, measured like the recording.

recorded_flight       a recording in the forms that the reference flights need
noise_sheet           measurement noise of the recording's sensors
tracking_controller   control along the recorded path
reference_flights     flights along the recorded path, and their measurement
rotor_speed_model     rotor speeds from motor commands, where none were measured
motors_only           motors and battery alone, for a recording without a pose
phase_surrogates      errors of VIO and commands, drawn by random phases
corner_bootstrap      errors of the gate detector, drawn by a bootstrap
"""
