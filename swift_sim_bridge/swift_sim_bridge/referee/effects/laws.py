"""Physics that no effect of the gap tool names; the tool must answer with an equation, or *unknown*."""

from swift_sim_bridge.referee.effects import planting, quantities
from swift_sim_bridge.referee.effects.effect import Effect
from swift_sim_bridge.referee.effects.planting import added
from swift_sim_bridge.referee.effects.quantities import ANGULAR_ACCELERATION, SPECIFIC_FORCE, on_any_axis, on_channel

# Six laws, see `simulator.strange`.
STRANGE = {
    "vortex_bump": Effect(
        "force",
        0.04,
        0.4,
        "share",
        added("strange", "vortex_bump"),
        on_any_axis(on_channel(f"{SPECIFIC_FORCE}_z", quantities.SINK_SPEED)),
        path="dives",
        acts_on_moment=True,
    ),
    "pad": Effect(
        "force",
        0.02,
        0.3,
        "share",
        planting.pad,
        on_any_axis(on_channel(f"{SPECIFIC_FORCE}_z", r"\w+_z within .*")),
        acts_on_moment=True,
    ),
    "lift": Effect(
        "force",
        2e-3,
        0.03,
        "N/(m/s)^2",
        added("strange", "lift"),
        on_any_axis(on_channel(f"{SPECIFIC_FORCE}_y", "v_x v_z")),
    ),
    "stall": Effect(
        "force",
        2.0,
        40.0,
        "share per square of advance ratio",
        added("strange", "stall"),
        on_any_axis(on_channel(f"{SPECIFIC_FORCE}_z", quantities.LATERAL_SPEED)),
        acts_on_moment=True,
    ),
    "cross_drag": Effect(
        "force",
        0.015,
        0.5,
        "N/(m/s)",
        added("strange", "cross_drag"),
        on_any_axis(
            on_channel(f"{SPECIFIC_FORCE}_x", quantities.drag("y")),
            on_channel(f"{SPECIFIC_FORCE}_y", quantities.drag("x")),
        ),
    ),
    "weathercock": Effect(
        "moment",
        1e-5,
        1e-3,
        "N m/(m/s)^2",
        added("strange", "weathercock"),
        on_any_axis(on_channel(f"{ANGULAR_ACCELERATION}_z", quantities.drag("y"))),
    ),
}


def _blind(layer: str, name: str, draw, channel: str, quantity: str) -> Effect:
    """Return a law of `simulator.blind` as an effect that acts on one channel; its author's size is 1."""
    expected = on_any_axis(on_channel(channel, quantity))
    return Effect(layer, BLIND_DETECTABLE, 1.0, "of the author's size", planting.law(name, draw), expected, path="race")


# Physics by an author who had not read the tool. What is expected was written before the first diagnosis. A law with
# memory acts by a present quantity times something that no equation of present quantities gives: the right answer is
# *unknown* in its layer and on its axis, with the present quantity.
BLIND_DETECTABLE = 1 / 3  # by hand, so that every case of the author's size is asked for
BLIND = {
    "bistable_wake": _blind(
        "force", "bistable_wake", planting.bistable_wake, f"{SPECIFIC_FORCE}_y", quantities.AIR_VELOCITY
    ),
    "twisting_arm": _blind(
        "moment", "twisting_arm", planting.twisting_arm, f"{ANGULAR_ACCELERATION}_z", quantities.TURNING_ROTOR
    ),
    "sliding_battery": _blind(
        "moment", "sliding_battery", planting.sliding_battery, f"{ANGULAR_ACCELERATION}_y", quantities.THRUST_OR_PULL
    ),
    "arm_resonance": _blind(
        "motor", "arm_resonance", planting.arm_resonance, quantities.ROTOR_SPEED, quantities.STEADY_SPEED
    ),
    "fretting_connector": _blind(
        "motor", "fretting_connector", planting.fretting_connector, "voltage", quantities.ELECTRICAL_LOAD
    ),
}
RELATED = {"vortex_bump": ("vortex_ring",), "stall": ("propeller_stall",)}  # effects that would name a law, nearly
