"""Effects of the rate loop: its gains in the firmware's numbers, as they stand in the vehicle file."""

from swift_ros.vehicle import Vehicle
from swift_sim_bridge.effects import Effect, Parameter

AXES = ("roll", "pitch", "yaw")
MAX_GAIN = 250.0  # largest gain that the firmware accepts
TERMS_OF_PID = {  # by letter: equation, manoeuvre; in the order of the file's entries
    "p": ("P = k_p (setpoint - gyro)", "quick rolls, pitches and yaws, logged by the flight controller"),
    "i": (
        "I = k_i integral of (setpoint - gyro)",
        "a minute of flight with long turns, logged by the flight controller",
    ),
    "d": ("D = -k_d d(filtered gyro)/dt", "flips and stops, logged by the flight controller"),
}


def effects(vehicle: Vehicle) -> tuple[Effect, ...]:
    """Return one effect for each of P, I and D; none where the vehicle file has no Betaflight gains."""
    if vehicle.controller.get("type") != "betaflight" or "pid" not in vehicle.controller:
        return ()
    return tuple(
        Effect(
            id=f"rate_loop_{letter}",
            layer="command",
            parameters=tuple(
                Parameter(f"{letter}_{axis}", "", ("controller", "pid", axis, index), step=1.0, low=0.0, high=MAX_GAIN)
                for axis in AXES
            ),
            equation=equation,
            sentence=f"the rate loop flies with {letter.upper()} = {{values}} (roll, pitch, yaw)",
            manoeuvre=manoeuvre,
            channels=("rate_loop",),
        )
        for index, (letter, (equation, manoeuvre)) in enumerate(TERMS_OF_PID.items())
    )
