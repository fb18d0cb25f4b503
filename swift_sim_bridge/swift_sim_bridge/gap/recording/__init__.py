"""Recordings as the gap tool evaluates them.

channel_names       readable names of channels, with their columns of a flight table
unavailable         the reason why evidence is missing
motor_record        motor commands with the rotor speeds that they cause
rate_pid            commands that a rate loop of type `rate_pid` received, by inversion of the loop
command_timing      delay and loss of each command
command_link        commands as sent and as received
betaflight_log      log and replay of Betaflight's rate loop
gate_observations   gates in images, associated with the gates of the map
flight_phase        the samples in which the vehicle flies
rotor_moments       whether the rotors turn the vehicle the way its file says
consistency         contradictions among channels, and the mistake that explains each
recording           all of it on one time grid
"""
