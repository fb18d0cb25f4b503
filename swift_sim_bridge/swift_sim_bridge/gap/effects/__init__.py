"""Effects as hypotheses of the gap tool.

Modules:
    catalogue: all effects of a vehicle, collected from the modules that simulate them.
    rate_loop: gains of a Betaflight rate loop as effects.
    patch: vehicles with another number at a path of the vehicle file.
    injection: vehicles with an effect at given values.
"""
