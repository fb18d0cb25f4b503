"""Speed of the physics: drone-steps per second and CPU time by batch and steps per call, and the speed of the bridge.

The step is that of training and bridge, in single precision as in training: rate loop, motors, battery, rotors, air,
rigid body. Other simulators are measured in the same run (`physics_rivals`), in an interpreter that has them.
"""

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import jax
import jax.numpy as jnp

from swift_ros import configuration
from swift_ros.betaflight import msp
from swift_ros.errors import UsageError
from swift_ros.vehicle import Vehicle
from swift_sim_bridge.benchmarks import physics_rivals
from swift_sim_bridge.benchmarks.physics_rivals import STEPS_A_CALL, Row, measure_calls
from swift_sim_bridge.flight_controller.configuration.vehicle_profile import profile_from_vehicle
from swift_sim_bridge.flight_controller.rate_loop.stick_path import ReceiverFrame
from swift_sim_bridge.physics.state import parameters_from_vehicle
from swift_sim_bridge.physics.terms.registry import PHYSICS
from swift_sim_bridge.simulation import simulator

BATCHES = (1, 100, 1000, 10000)  # vehicles that are simulated together
STEP_S, TICK_S = 0.002, 0.01  # s; physics step and control tick
BRIDGE_TICKS = 1000  # ticks of the bridge that are timed: 10 s of flight
TIMEOUT_S = 900.0  # s for all other simulators together; ends a run that hangs
SET_RAW_RC = 200  # MSP command
PAPER_TERMS = ("rotor_gyroscopic", "aerodynamic_polynomial")  # of the Methods, eqs 1-6
EXAMPLES = {name: term.example for name, term in PHYSICS.items()}  # every term on
RICH_PACK = {
    "open_circuit_curve": (16.8, 16.3, 15.9, 15.6, 15.3),
    "rc2_resistance": 0.002,
    "rc2_time": 60.0,
    "energy": 9e4,
    "temperature_slope": -0.01,
    "heat_capacity": 200.0,
}


@dataclass(frozen=True)
class Model:
    """One model that is measured.

    Attributes:
        name: in the table.
        description: what it simulates.
        vehicle: that has it.
    """

    name: str
    description: str
    vehicle: Vehicle


def models(folder: Path) -> list[Model]:
    """Return the models that are measured: that of the paper, and that with every term."""
    shipped = configuration.load(Vehicle, folder / "drone.yaml")
    full = replace(shipped, terms=EXAMPLES, battery=replace(shipped.battery, **RICH_PACK))
    common = "rate loop, motor map and lag, battery, thrust and torque, rigid body"
    return [
        Model(
            "ours, the paper's model",
            f"{common}, spin-up and gyroscopics, polynomial of eq. 5",
            replace(shipped, terms={name: EXAMPLES[name] for name in PAPER_TERMS}),
        ),
        Model(
            "ours, every term on",
            f"{common}; second RC branch, open-circuit curve, energy, temperature; " + ", ".join(EXAMPLES),
            full,
        ),
    ]


def _caller(vehicle: Vehicle, batch: int, steps: int) -> Callable[[], object]:
    """Return a function that advances a batch by `steps` steps at each call; the first call compiles it."""
    parameters = parameters_from_vehicle(vehicle, jnp.float32)
    profile = profile_from_vehicle(vehicle, jnp.float32)
    setpoint = jax.random.normal(jax.random.key(0), (batch, 3), jnp.float32)
    frame = ReceiverFrame(setpoint, jnp.full(batch, 0.35, jnp.float32), jnp.ones(batch, bool))
    level = jnp.broadcast_to(jnp.array([0.0, 0.0, 0.0, 1.0], jnp.float32), (batch, 4))
    high = jnp.broadcast_to(jnp.array([0.0, 0.0, 50.0], jnp.float32), (batch, 3))
    flight = simulator.initial_flight(high, level, len(vehicle.rotors), profile, parameters)

    @jax.jit
    def fly(flight, parameters, profile):
        model, stepping = simulator.FlightModel(parameters, profile), simulator.Stepping(steps, STEP_S)
        return simulator.advance(flight, frame, model, stepping)[0]

    holder = [flight]

    def call():
        holder[0] = jax.block_until_ready(fly(holder[0], parameters, profile))

    return call


def measure_ours(folder: Path, batches=BATCHES, progress=print) -> list[Row]:
    """Return a row for each model, batch and number of steps per call; single precision, semi-implicit Euler, 2 ms."""
    rows = []
    with jax.enable_x64(False):
        for model in models(folder):
            for steps in STEPS_A_CALL:
                for batch in batches:
                    row = measure_calls(model.name, _caller(model.vehicle, batch, steps), batch, steps)
                    progress(f"{row.name}, {batch} drones, {steps} steps a call: {row.steps_per_s:.3g} drone-steps/s")
                    rows.append(row)
    return rows


def measure_rivals(python: str, progress=print) -> tuple[list[Row], dict]:
    """Return the rows of other simulators, and by name what each simulates or why it is not measured.

    Args:
        python: an interpreter that has them.
        progress: called with one line of text for each.

    Raises:
        UsageError: the interpreter cannot be run.
    """
    words = [os.path.abspath(python) if os.sep in python else python, physics_rivals.__file__]
    try:
        with tempfile.TemporaryDirectory() as folder:  # MuJoCo writes a log into its working directory
            ended = subprocess.run(words, capture_output=True, text=True, timeout=TIMEOUT_S, cwd=folder)
    except OSError as error:
        raise UsageError(f"--rivals {python} cannot be run: {error.strerror}") from error
    except subprocess.TimeoutExpired:
        return [], {"rivals": f"not measured: took longer than {TIMEOUT_S:.0f} s"}
    if ended.returncode:
        return [], {"rivals": f"not measured: {ended.stderr.strip().splitlines()[-1]}"}
    answer = json.loads(ended.stdout.splitlines()[-1])
    for name, description in answer["says"].items():
        progress(f"{name}: {description}")
    return [Row(**row) for row in answer["rows"]], answer["says"]


def bridge_core(folder: Path) -> float:
    """Return the speed of the simulated vehicle in multiples of real time: with sensors and MSP, no images, 100 Hz."""
    # imported here, because it loads the sensors and the flight controller
    from swift_sim_bridge.simulation.simulated_vehicle import TICK_NS, SimulatedVehicle

    sticks = b"".join(value.to_bytes(2, "little") for value in (1500, 1500, 1000, 1500, 1000, 1000, 1000, 1000))
    frame = msp.encode(msp.Message(SET_RAW_RC, sticks))
    with jax.enable_x64(True):  # as the bridge runs it
        vehicle = SimulatedVehicle(folder, 0)
        vehicle.compile()

        def tick():
            vehicle.sense(vehicle.tick * TICK_NS)
            vehicle.flight_controller.feed(frame)
            vehicle.advance()

        for _ in range(50):
            tick()
        begun = time.perf_counter()
        for _ in range(BRIDGE_TICKS):
            tick()
        return BRIDGE_TICKS * TICK_S / (time.perf_counter() - begun)


def measure(folder: Path, rivals: str | None = None, progress=print) -> dict:
    """Return {"rows": [...], "says": {name: model, step and integrator}, "bridge_core": multiple of real time}.

    Args:
        folder: configuration folder.
        rivals: Python interpreter that has crazyflow, rotorpy or l2f; this one where None.
        progress: called with lines of text.
    """
    descriptions = {model.name: f"{model.description}; 2 ms, semi-implicit Euler, float32" for model in models(folder)}
    rows = measure_ours(folder, progress=progress)
    theirs, their_descriptions = measure_rivals(rivals or sys.executable, progress)
    return {
        "rows": [row._asdict() for row in rows + theirs],
        "says": descriptions | their_descriptions,
        "bridge_core": bridge_core(folder),
    }


def table(measured: dict) -> list[tuple[str, ...]]:
    """Return rows of text: model, drones, steps per call, drone-steps per second, CPU s per million drone-steps."""
    rows = [("physics", "drones", "steps a call", "drone-steps/s", "CPU s a million")]
    for row in measured["rows"]:
        rows.append(
            (
                row["name"],
                str(row["batch"]),
                str(row["steps"]),
                f"{row['steps_per_s']:,.0f}",
                f"{1e6 * row['cpu_s_per_step']:.3f}",
            )
        )
    return rows
