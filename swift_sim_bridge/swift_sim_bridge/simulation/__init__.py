"""The simulation of one vehicle: physics, rate loop and sensors together.

simulator: one tick of rate loop and physics, compiled, for one vehicle or a batch.
packing: trees of arrays as a few vectors, for fast compiled calls.
sitl_vehicle: physics driven by the real firmware (Betaflight SITL).
simulated_vehicle: one vehicle with flight controller and sensors, as the bridge flies it.
"""
