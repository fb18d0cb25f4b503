"""Speed of other open simulators, from their packages, for the table of `physics_speed`.

The file also runs as a script in an interpreter without Swift; it then prints its rows as one line of JSON. A simulator
that is not installed is reported as such.
"""

import enum
import importlib.util
import json
import sys
import time
from collections.abc import Callable
from typing import NamedTuple

STEPS_A_CALL = (1, 10)  # physics steps in one call
ROUNDS, ROUND_S = 3, 0.4  # repetitions of a measurement, of which the fastest counts, and s of each


class Row(NamedTuple):
    """One measurement.

    Attributes:
        name: of the model.
        batch: number of drones.
        steps: per call.
        steps_per_s: drone-steps per second in the fastest round.
        cpu_s_per_step: CPU time per drone-step, s.
    """

    name: str
    batch: int
    steps: int
    steps_per_s: float
    cpu_s_per_step: float


def measure_calls(name: str, call: Callable[[], object], batch: int, steps: int) -> Row:
    """Return the row of `call`, which advances `batch` drones by `steps` steps; two calls before are not measured."""
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

    if sys.version_info < (3, 12):  # it tests whether a str is in an Enum, an error in older Pythons
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
    description = "rotor lag, thrust and torque, body drag, rigid body, attitude controller"
    return rows, f"{description}; 2 ms, explicit Euler, float32"


def rotorpy() -> tuple[list[Row], str]:
    """Return (rows, what was simulated) of RotorPy's single vehicle, which has no batches."""
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
                for _ in range(steps):  # from the same state: without a controller the state diverges
                    step(device, *given)

            rows.append(measure_calls("l2f", call, batch, steps))
    return rows, "rotor lag, thrust and torque, rigid body; its own step of 10 ms, Runge-Kutta 4, float32"


RIVALS = {"crazyflow": crazyflow, "rotorpy": rotorpy, "l2f": l2f}


def measure() -> dict:
    """Return {"rows": [...], "says": {rival: what was simulated, or why nothing was}}."""
    rows, descriptions = [], {}
    for name, rival in RIVALS.items():
        if importlib.util.find_spec(name) is None:
            descriptions[name] = "not installed, not measured"
            continue
        try:
            found, descriptions[name] = rival()
        except (ImportError, AttributeError, TypeError, ValueError, KeyError) as error:  # another version's interface
            descriptions[name] = f"not measured, its interface has changed: {error}"
            continue
        rows += [row._asdict() for row in found]
    return {"rows": rows, "says": descriptions}


if __name__ == "__main__":
    print(json.dumps(measure()))
