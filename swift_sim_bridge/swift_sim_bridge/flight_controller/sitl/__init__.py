"""Betaflight SITL, the real firmware, in the simulated flight controller's place."""
