"""Speed of the physics: drone-steps a second and CPU time by batch and steps a call, and the bridge's core at N = 1.

The same step that training and the bridge run, in single precision as training does: rate loop, motors, battery,
rotors, air, rigid body. Rivals are measured beside it in the same run (`physics_rivals`), in an interpreter that has
them.
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
from swift_sim_bridge.simulation import simulator

BATCHES = (1, 100, 1000, 10000)
STEP_S, TICK_S = 0.002, 0.01
BRIDGE_TICKS = 1000
PATIENCE_S = 900.0  # for the rivals
SET_RAW_RC = 200
PAPER = {  # Methods, eqs 1-6: coefficients of the size of the shipped vehicle's drags
    "rotor_gyroscopic": {"inertia": 1e-5},
    "aerodynamic_polynomial": {
        "f_x": [-0.02, -0.004, 0.0, -1e-7],
        "f_y": [-0.02, -0.004, 0.0, -1e-7],
        "f_z": [-0.02, -0.008, 0.01, 0.002, 1e-8, -2e-7, 1e-9],
        "tau_x": [1e-4, 1e-5, 1e-10, 1e-9, 1e-11],
        "tau_y": [-1e-4, 1e-5, 1e-10, 1e-9, 1e-11],
        "tau_z": [1e-5, 1e-5],
    },
}
EVERY = PAPER | {
    "rotor_drag": {"k_d": 4e-5},
    "linear_drag": {"c": [0.02, 0.02, 0.02]},
    "body_drag": {"c": [0.004, 0.004, 0.008]},
    "drag_center": {"position": [0.0, 0.0, 0.005]},
    "lift_cross": {"a": 0.003, "b": 0.003},
    "flapping_moment": {"k_f": 2e-7},
    "axial_inflow": {"k_z": 3e-5},
    "translational_lift": {"k_h": 1e-3, "saturation": 8.0},
    "ground_effect": {"k": 1.0},
    "vortex_ring": {"loss": 0.2, "buffet": 0.1},
    "thrust_axis_tilt": {"tilt": [0.005, 0.005]},
    "rotor_gain": {"gain": [0.01, -0.01, 0.01, -0.01]},
    "motor_heat": {"speed_loss": 1e-4},
    "slung_load": {"mass": 0.01, "length": 0.1, "damping": 0.5},
    "wind": {"velocity": [1.0, 0.5, 0.0]},
    "gust": {"wind_20ft": 3.0},
    "local_draught": {"center": [0.0, 0.0, 2.0], "radius": 2.0, "velocity": [2.0, 0.0, 0.0]},
    "com_offset": {"position": [0.001, 0.001, 0.0]},
    "payload": {"mass": 0.02, "position": [0.01, 0.0, 0.0]},
    "damaged_propeller": {"rotor": 1, "loss": 0.02, "imbalance": 1e-6},
    "command_latency": {"delay": 0.01, "jitter": 0.002},
    "dropped_commands": {"share": 0.01},
    "throttle_curve": {"gain": 0.02},
    "rate_scale": {"scale": [1.02, 0.98, 1.0]},
}
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
    """What is simulated: a name, what is in it, and the vehicle that has it."""

    name: str
    says: str
    vehicle: Vehicle


def models(folder: Path) -> list[Model]:
    """Return the models that are measured: the paper's, and every term on."""
    shipped = configuration.load(Vehicle, folder / "drone.yaml")
    full = replace(shipped, terms=EVERY, battery=replace(shipped.battery, **RICH_PACK))
    rest = "rate loop, motor map and lag, battery, thrust and torque, rigid body"
    return [
        Model(
            "ours, the paper's model",
            f"{rest}, spin-up and gyroscopics, polynomial of eq. 5",
            replace(shipped, terms=PAPER),
        ),
        Model(
            "ours, every term on",
            f"{rest}; second RC branch, open-circuit curve, energy, temperature; " + ", ".join(EVERY),
            full,
        ),
    ]


def _caller(vehicle: Vehicle, batch: int, steps: int) -> Callable[[], object]:
    """Return what flies `steps` steps of a batch on at each call, compiled when called first."""
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


def measure_ours(folder: Path, batches=BATCHES, tell=print) -> list[Row]:
    """Return a row for each model, batch and steps a call; single precision, semi-implicit Euler at 2 ms."""
    rows = []
    with jax.enable_x64(False):
        for model in models(folder):
            for steps in STEPS_A_CALL:
                for batch in batches:
                    row = measure_calls(model.name, _caller(model.vehicle, batch, steps), batch, steps)
                    tell(f"{row.name}, {batch} drones, {steps} steps a call: {row.steps_per_s:.3g} drone-steps/s")
                    rows.append(row)
    return rows


def measure_rivals(python: str, tell=print) -> tuple[list[Row], dict]:
    """Return (rows, {rival: what it simulates, or why it is not measured}) of the interpreter `python`.

    Raises UsageError when that cannot be run.
    """
    words = [os.path.abspath(python) if os.sep in python else python, physics_rivals.__file__]
    try:
        with tempfile.TemporaryDirectory() as folder:  # MuJoCo leaves its log wherever it runs
            ended = subprocess.run(words, capture_output=True, text=True, timeout=PATIENCE_S, cwd=folder)
    except OSError as error:
        raise UsageError(f"--rivals {python} cannot be run: {error.strerror}") from error
    except subprocess.TimeoutExpired:
        return [], {"rivals": f"not measured: took longer than {PATIENCE_S:.0f} s"}
    if ended.returncode:
        return [], {"rivals": f"not measured: {ended.stderr.strip().splitlines()[-1]}"}
    answer = json.loads(ended.stdout.splitlines()[-1])
    for name, says in answer["says"].items():
        tell(f"{name}: {says}")
    return [Row(**row) for row in answer["rows"]], answer["says"]


def bridge_core(folder: Path) -> float:
    """Return how many times faster than real time the simulated vehicle runs: sensors and MSP on, no images, 100 Hz."""
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


def measure(folder: Path, rivals: str | None = None, tell=print) -> dict:
    """Return {"rows": [...], "says": {name: model, step and integrator}, "bridge_core": multiple of real time}.

    rivals: Python interpreter that has crazyflow, rotorpy or l2f; this one where None.
    """
    says = {model.name: f"{model.says}; 2 ms, semi-implicit Euler, float32" for model in models(folder)}
    rows = measure_ours(folder, tell=tell)
    theirs, about = measure_rivals(rivals or sys.executable, tell)
    return {"rows": [row._asdict() for row in rows + theirs], "says": says | about, "bridge_core": bridge_core(folder)}


def table(measured: dict) -> list[tuple[str, ...]]:
    """Return rows of text: model, drones, steps a call, drone-steps a second, CPU seconds a million drone-steps."""
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
