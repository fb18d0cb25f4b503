"""The laws of `simulator.blind` as effects that the referee conceals, with the numbers that their author draws.

The size is 1 for a law as its author wrote it; every case of the family has it, whatever the vehicle. What is expected
was written before the first diagnosis. A law with memory acts by a present quantity times something that no equation
of present quantities gives: the right answer is *unknown* in its layer and on its axis, with the present quantity.
"""

from collections.abc import Callable

import numpy as np

from swift_sim_bridge.referee.effect import Effect
from swift_sim_bridge.referee.planting import random_sign
from swift_sim_bridge.referee.quantities import (
    ANGULAR_ACCELERATION,
    ELECTRICAL_LOAD,
    ROTOR_SPEED,
    SPECIFIC_FORCE,
    STEADY_SPEED,
    THRUST,
    on_any_axis,
    on_channel,
)

Draw = Callable[[float, np.random.Generator], dict]  # draw(size, rng) -> numbers of a law by name
DETECTABLE = 1 / 3  # by hand, so that every case is asked for
AIR_VELOCITY = (  # alone, or with rotor speed or thrust
    r"((Omega|thrust) )?(\|v\| )?(\|v\||v_[xyz]|v_xy\^2|v_xy v_z|v_[xyz] v_[xyz]|min\(v_z, 0\))|modelled force [xy]"
)
TURNING_ROTOR = rf"{THRUST}|(sum of spin Omega )?omega_[xy]"  # thrust, rotor speed and body rate
THRUST_OR_PULL = rf"1|{THRUST}|((thrust|Omega|\|v\|) )?v_x|modelled force x"  # thrust, or what pulls along x


def _law(layer: str, name: str, draw: Draw, channel: str, quantity: str) -> Effect:
    """Return the effect of a law that acts on one channel."""

    def plant(content, size, rng):
        numbers = draw(size, rng).items()
        return {("blind", name, key, *at): float(one) for key, value in numbers for at, one in np.ndenumerate(value)}

    return Effect(layer, DETECTABLE, 1.0, "of the author's size", plant, on_any_axis(on_channel(channel, quantity)))


def _bistable_wake(size, rng):
    """Return the numbers of a wake."""
    return {
        "lift_area": size * rng.uniform(0.0045, 0.0100),  # m^2
        "slip_gain": rng.uniform(1.6, 3.0),
        "bias": random_sign(rng) * rng.uniform(0.02, 0.06),
        "relaxation_length": rng.uniform(0.6, 1.4),  # m
        "critical_speed": rng.uniform(3.0, 5.0),  # m/s
    }


def _twisting_arm(size, rng):
    """Return the numbers of four arms, one of which is soft in torsion."""
    soft = np.arange(4) == rng.integers(4)
    return {
        "softness": size / rng.uniform(7.5, 12.0) * soft,  # rad/(N m)
        "rotor_inertia": rng.uniform(5.5e-6, 8.0e-6),  # kg m^2
        "shear_offset": random_sign(rng) * rng.uniform(0.001, 0.004),  # m
    }


def _sliding_battery(size, rng):
    """Return the numbers of a loose pack."""
    return {
        "battery": size * rng.uniform(0.18, 0.25),  # kg
        "slack": rng.uniform(0.009, 0.016),  # m, each way
        "height": rng.uniform(0.02, 0.035),  # m over the centre of mass
        "preload": rng.uniform(0.6, 1.5),  # m/s^2
        "friction": rng.uniform(0.05, 0.12),
        "mobility": rng.uniform(0.010, 0.030),  # m/s per m/s^2
    }


def _arm_resonance(size, rng):
    """Return the numbers of four arms that resonate with their rotors."""
    mode = rng.uniform(1400.0, 2000.0) * (1.0 + rng.uniform(-0.05, 0.05, 4))  # rad/s
    damping = rng.uniform(0.10, 0.15)
    sag = size * rng.uniform(0.035, 0.070) * rng.uniform(0.7, 1.15, 4)  # of the rotor speed, at a motor lag of 35 ms
    return {"mode": mode, "damping": damping, "peak": sag * mode / 0.035}  # rad/s^2


def _fretting_connector(size, rng):
    """Return the numbers of a worn connector."""
    return {
        "resistance": size * rng.uniform(0.014, 0.030),  # ohm
        "threshold": rng.uniform(13.0, 19.0),  # m/s^2
        "opening_rate": rng.uniform(0.8, 2.0),  # 1/s per m/s^2
        "healing_time": rng.uniform(0.25, 0.80),  # s
    }


BLIND = {
    "bistable_wake": _law("force", "bistable_wake", _bistable_wake, f"{SPECIFIC_FORCE}_y", AIR_VELOCITY),
    "twisting_arm": _law("moment", "twisting_arm", _twisting_arm, f"{ANGULAR_ACCELERATION}_z", TURNING_ROTOR),
    "sliding_battery": _law("moment", "sliding_battery", _sliding_battery, f"{ANGULAR_ACCELERATION}_y", THRUST_OR_PULL),
    "arm_resonance": _law("motor", "arm_resonance", _arm_resonance, ROTOR_SPEED, STEADY_SPEED),
    "fretting_connector": _law("motor", "fretting_connector", _fretting_connector, "voltage", ELECTRICAL_LOAD),
}
