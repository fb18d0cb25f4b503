"""The simulated flight controller: Betaflight's rate loop and mixer, and the firmware around it that speaks MSP."""
