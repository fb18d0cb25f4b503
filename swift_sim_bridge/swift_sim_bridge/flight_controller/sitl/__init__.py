"""Betaflight SITL: the real firmware in place of the simulated one.

pass_clock: clock that counts passes of the rate loop, for reproducible runs.
launch: script that ties the program to its parent process.
program: the program as a child process.
udp: UDP packets of states and motor outputs.
cli: the firmware's command line.
cli_lines: CLI lines that configure the firmware.
sitl: the running firmware, stepped pass by pass.
replay: recorded gyro and sticks through the firmware.
msp_proxy: MSP port in front of the firmware.
"""
