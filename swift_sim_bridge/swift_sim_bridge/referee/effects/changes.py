"""What a pilot may have changed, and the numbers of a vehicle file that may be wrong by a large factor."""

from swift_sim_bridge.referee.effects import planting
from swift_sim_bridge.referee.effects.planting import added

# For recordings of pose and motor commands alone: effect, how it is planted, and its
# smallest and largest size in the effect's unit.
CHANGES = {
    "cut propeller": ("damaged_propeller", planting.damaged_propeller, (0.05, 0.3)),
    "hung weight": ("payload", planting.load([-0.02, -0.02, -0.12], [0.02, 0.02, -0.06]), (0.03, 0.15)),
    "heavier battery": ("payload", planting.load([-0.01, -0.01, -0.04], [0.01, 0.01, -0.02]), (0.04, 0.15)),
    "weaker pack": ("battery_sag", added("battery", "resistance"), (0.01, 0.04)),
}
CHANGES_OF_ROTORPY = ("hung weight", "heavier battery")

# Effect, and paths of the numbers.
FAR = {
    "motor_time_constant": (("motor", "time_constant_up"), ("motor", "time_constant_down")),
    "body_drag": tuple(("terms", "body_drag", "c", i) for i in range(3)),
    "rotor_drag": (("terms", "rotor_drag", "k_d"),),
    "battery_sag": (("battery", "resistance"),),
}
FACTORS = (3.0, 10.0, 30.0)
