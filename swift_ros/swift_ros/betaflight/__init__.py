"""The link to a Betaflight flight controller.

msp: MSP framing.
msp_messages: payloads of MSP messages.
arming_flags: arming-disable flags of the firmware.
transport: bytes over TCP or a serial device.
read_back: configuration of the flight controller.
sticks: body rates and thrust to stick positions.
pack: battery voltage under a commanded thrust.
msp_session: stick frames, requests and answers.
watchdog: silent inputs and clock faults.
failsafe: the end of a flight in angle mode.
link_settings: section `betaflight` of nodes.yaml.
link: the state machine of a flight.
"""
