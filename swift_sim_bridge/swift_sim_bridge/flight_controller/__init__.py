"""The simulated flight controller: Betaflight 4.5, from MSP bytes to motor commands.

Imports go in this order: rate_loop, configuration, the modules of this folder, sitl.

rate_loop: the rate loop and mixer, compiled with the physics.
configuration: the vehicle file's `controller` section and CLI dumps.
firmware_settings: settings of the firmware in `config/simulation.yaml`.
modes: flight modes switched by AUX channels.
receiver: receiver frames and lost signals.
arming: arming state and arming-disable flags.
failsafe: the firmware's failsafe.
msp_framing: MSP frames.
msp_server: answers to MSP requests.
firmware: the flight controller, one tick of 10 ms at a time.
msp_socket: MSP on a TCP port or pseudo-terminal.
sitl: the real firmware (Betaflight SITL) in place of the simulated one.
"""
