"""Speed of other open simulators, from their packages, for the table of `physics_speed`; absence is said in a line.

This file also runs by itself, in an interpreter that need not have Swift, and then prints its rows as JSON in a line.
"""

import enum
import importlib.util
import json
import sys
import time
from collections.abc import Callable
from typing import NamedTuple

STEPS_A_CALL = (1, 10)
ROUNDS, ROUND_S = 3, 0.4


class Row(NamedTuple):
    """name; batch: drones at once; steps: a call; steps_per_s: drone-steps, best of the rounds; cpu_s_per_step."""

    name: str
    batch: int
    steps: int
    steps_per_s: float
    cpu_s_per_step: float


def measure_calls(name: str, call: Callable[[], object], batch: int, steps: int) -> Row:
    """Return the row of `call`, which ends when `batch` drones have flown `steps` steps; its first two do not count."""
    call()
    begun = time.perf_counter()
    call()
    count = max(1, round(ROUND_S / max(time.perf_counter() - begun, 1e-6)))
    best = (0.0, 0.0)
    for _ in range(ROUNDS):
        begun, spent = time.perf_counter(), time.process_time()
        for _ in range(count):
            call()
        flown = count * batch * steps
        spent, taken = time.process_time() - spent, time.perf_counter() - begun
        best = max(best, (flown / taken, spent / flown))
    return Row(name, batch, steps, *best)


def crazyflow() -> tuple[list[Row], str]:
    """Return (rows, what was simulated) of crazyflow's first-principles model under its attitude controller."""
    import jax
    import jax.numpy as jnp
    from crazyflow.control import Control
    from crazyflow.dynamics import Dynamics
    from crazyflow.sim import Sim
    from crazyflow.sim.integration import Integrator

    if sys.version_info < (3, 12):  # it asks whether a text is in an Enum, which older Pythons refuse to answer
        enum.EnumMeta.__contains__ = lambda kind, value: isinstance(value, kind) or value in kind._value2member_map_
    rows, choice = [], {"dynamics": Dynamics.first_principles, "control": Control.attitude}
    choice["integrator"] = Integrator.euler
    for batch in (1, 100, 1000, 10000):
        sim = Sim(n_worlds=batch, freq=500, **choice)
        thrust = 4 * 0.08
        command = jnp.broadcast_to(jnp.array([0.05, 0.02, 0.0, thrust]), (batch, 1, 4))
        for steps in STEPS_A_CALL:

            def call(sim=sim, steps=steps, command=command):
                sim.attitude_control(command)
                sim.step(steps)
                jax.block_until_ready(sim.data)

            rows.append(measure_calls("crazyflow", call, batch, steps))
    says = "rotor lag, thrust and torque, body drag, rigid body, attitude controller"
    return rows, f"{says}; 2 ms, explicit Euler, float32"


def rotorpy() -> tuple[list[Row], str]:
    """Return (rows, what was simulated) of RotorPy's single vehicle, which flies one at a time."""
    import numpy as np
    from rotorpy.vehicles.crazyflie_params import quad_params
    from rotorpy.vehicles.multirotor import Multirotor

    vehicle = Multirotor(quad_params)
    state = [dict(vehicle.initial_state)]
    control = {"cmd_motor_speeds": np.full(4, 1800.0)}
    rows = []
    for steps in STEPS_A_CALL:

        def call(steps=steps):
            for _ in range(steps):
                state[0] = vehicle.step(state[0], control, 0.002)

        rows.append(measure_calls("rotorpy", call, 1, steps))
    return rows, "rotor lag, thrust, rotor and body drag, flapping, rigid body; 2 ms, adaptive Runge-Kutta, float64"


def l2f() -> tuple[list[Row], str]:
    """Return (rows, what was simulated) of learning-to-fly's simulator; its vectors have fixed sizes."""
    import l2f as package
    import numpy as np

    device, rows = package.Device(), []
    for batch in (1, 128, 1024, 8192):
        vector, kind = (package, "") if batch == 1 else (getattr(package, f"vector{batch}"), "Vector")
        environment, parameters, rng, state, moved = (
            getattr(vector, kind + name)() for name in ("Environment", "Parameters", "Rng", "State", "State")
        )
        vector.initialize_environment(device, environment)
        vector.initialize_rng(device, rng, 0)
        vector.sample_initial_parameters(device, environment, parameters, rng)
        vector.sample_initial_state(device, environment, parameters, state, rng)
        action = np.zeros((batch, 4) if kind else 4, dtype=np.float32)
        for steps in STEPS_A_CALL:

            def call(steps=steps, step=vector.step, given=(environment, parameters, state, action, moved, rng)):
                for _ in range(steps):  # from the same state: a flight without a pilot ends among infinities
                    step(device, *given)

            rows.append(measure_calls("l2f", call, batch, steps))
    return rows, "rotor lag, thrust and torque, rigid body; its own step of 10 ms, Runge-Kutta 4, float32"


RIVALS = {"crazyflow": crazyflow, "rotorpy": rotorpy, "l2f": l2f}


def measure() -> dict:
    """Return {"rows": [...], "says": {rival: what was simulated, or why nothing was}}."""
    rows, says = [], {}
    for name, rival in RIVALS.items():
        if importlib.util.find_spec(name) is None:
            says[name] = "not installed, not measured"
            continue
        try:
            found, says[name] = rival()
        except (ImportError, AttributeError, TypeError, ValueError, KeyError) as error:  # another version's interface
            says[name] = f"not measured, its interface is another one: {error}"
            continue
        rows += [row._asdict() for row in found]
    return {"rows": rows, "says": says}


if __name__ == "__main__":
    print(json.dumps(measure()))
