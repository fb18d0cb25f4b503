"""The referee's simulator shares no code with the production simulator, and its accelerations agree with it."""

import re
import subprocess
import sys
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest
from plant_states import content, slopes, state

from swift_ros.configuration import build
from swift_ros.vehicle import GRAVITY, Vehicle
from swift_sim_bridge import referee
from swift_sim_bridge.physics import battery, motors
from swift_sim_bridge.physics.state import parameters_from_vehicle
from swift_sim_bridge.physics.terms import quantities, registry
from swift_sim_bridge.physics.terms.motion import Motion
from swift_sim_bridge.physics.terms.vectors import Vector
from swift_sim_bridge.referee.simulator import (
    plant,
    polynomial,
    vectors,
)

pytestmark = pytest.mark.usefixtures("double_precision")
FOLDER = Path(referee.__file__).parent
MAY_IMPORT_LATE = {"runner.py", "rotorpy_flight.py"}  # the tool, and RotorPy
FORBIDDEN = ("effects", "gap", "physics", "sensors", "simulation", "identification", "flight_controller")
ALL = {  # every effect of force and moment at once
    "rotor_drag": {"k_d": 6e-5},
    "linear_drag": {"c": [0.2, 0.3, 0.1]},
    "body_drag": {"c": [0.02, 0.03, 0.04]},
    "drag_center": {"position": [0.004, -0.006, 0.01]},
    "lift_cross": {"a": 0.01, "b": -0.02},
    "flapping_moment": {"k_f": 1e-6},
    "axial_inflow": {"k_z": 6e-5},
    "translational_lift": {"k_h": 5e-3, "saturation": 9.0},
    "propeller_stall": {"slope": 1.5, "onset": 0.02},
    "ground_effect": {"k": 2.0},
    "vortex_ring": {"loss": 0.3},
    "thrust_axis_tilt": {"tilt": [0.02, -0.01]},
    "com_offset": {"position": [0.003, -0.002, 0.005]},
    "payload": {"mass": 0.05, "position": [0.03, -0.02, 0.04]},
    "damaged_propeller": {"rotor": 2, "loss": 0.1},
    "wind": {"velocity": [3.0, -2.0, 0.5]},
    "local_draught": {"center": [0.5, 0.3, 1.0], "radius": 4.0, "velocity": [2.0, -3.0, 1.0]},
}


def test_only_the_runner_imports_the_tool_and_no_module_the_production_simulator():
    sources = {path.name: path.read_text() for path in FOLDER.rglob("*.py")}
    paths = [path.relative_to(FOLDER).with_suffix("") for path in FOLDER.rglob("*.py") if path.stem != "__init__"]
    modules = [".".join(("swift_sim_bridge.referee", *path.parts)) for path in paths]
    program = f"import sys; from importlib import import_module; [*map(import_module, {modules})]; print(*sys.modules)"
    loaded = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True).stdout.split()
    assert set(modules) <= set(loaded)
    assert not [name for name in loaded if re.match(rf"swift_sim_bridge\.({'|'.join(FORBIDDEN)})(\.|$)", name)]
    late = re.compile(r"^ +(from \S+ import|import) |import_module|__import__", re.MULTILINE)
    assert {name for name, text in sources.items() if late.search(text)} == MAY_IMPORT_LATE


@pytest.mark.parametrize("given", [{}, *({name: entry} for name, entry in ALL.items()), ALL])
def test_accelerations_agree_with_the_production_simulator_for_every_effect(given):
    if "drag_center" in given:
        given = given | {"body_drag": ALL["body_drag"]}
    described = content(terms=given)
    parameters = parameters_from_vehicle(build(Vehicle, described, "test"), np.float64)
    spin = np.array([1100.0, 1300.0, 1250.0, 900.0])
    at = state((0.2, -0.1, 0.3), (2.0, -3.0, -5.0), (1.0, -2.0, 0.5), spin, (0.1, -0.2, 0.3, 0.9))
    p, q, v, w, *_ = at
    air = registry.air_velocity(Vector(*p), {}, parameters)
    v_body = np.array(vectors.rotate_back(q, vectors.subtract(v, air)))
    motion = Motion(np.array(p), np.array(q), v_body, np.array(w), spin, np.zeros(4))
    force, moment = registry.wrench(motion, parameters)
    inertia = np.asarray(parameters.inertia)
    turning = np.linalg.solve(inertia, np.asarray(moment) - np.cross(w, inertia @ np.array(w)))
    slope, outputs = slopes(described, at)
    np.testing.assert_allclose(outputs.specific_force, np.asarray(force) / float(parameters.mass), rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(outputs.angular_acceleration, turning, rtol=1e-8, atol=1e-8)
    gravity = vectors.subtract(vectors.rotate(q, outputs.specific_force), slope.v)
    np.testing.assert_allclose(gravity, [0.0, 0.0, GRAVITY], atol=1e-9)


def test_motors_and_battery_agree_with_the_production_simulator():
    described = content()
    parameters = parameters_from_vehicle(build(Vehicle, described, "test"), np.float64)
    at = state(spin=[1100.0, 1300.0, 1250.0, 900.0])
    power = battery.power(np.array(at.rotor_speed), parameters.rotors.torque_coefficient, parameters.battery)
    voltage, current = battery.voltage_and_current(power, at.charge, at.rc, parameters.battery)
    slope, outputs = slopes(described, at, u=0.4)
    assert outputs.voltage == pytest.approx(float(voltage), rel=1e-12)
    assert slope.charge == pytest.approx(float(current), rel=1e-12)
    target = motors.steady_speed(jnp.full(4, 0.4), voltage, parameters.motors)
    np.testing.assert_allclose(
        slope.rotor_speed, (target - np.array(at.rotor_speed)) / described["motor"]["time_constant_up"]
    )


def test_an_equation_with_every_quantity_agrees_with_the_production_simulator():
    names = [*quantities.MOTION, "near(1,-1,2,6.0)", "over(|v|,1.5)", "over(v_xy,40)", "thrust_2", "Omega_3"]
    names.remove("spin_Omega'")  # no rotor accelerates here
    row = {"coefficient": 0.01, "range": [-1e3, 1e3]}
    entry = {side: dict.fromkeys(names[i::6], row) for i, side in enumerate(polynomial.WRENCH)}
    entry["force_x"] |= {"v_x v_z": row, "v_y^2": row, "thrust v_xy^2": {"coefficient": 0.01, "range": [-5.0, 5.0]}}
    at_rotors = [*quantities.ROTOR, "over(mu,0.01)", "around(sink,0.8,0.7)", "near(1,-1,2,6.0)"]
    entry["rotor_thrust"] = dict.fromkeys(at_rotors, row) | {"thrust mu^2": {"coefficient": 3.0, "range": [0.0, 0.004]}}
    described = content(terms={"equation": entry})
    parameters = parameters_from_vehicle(build(Vehicle, described, "test"), np.float64)
    at = state((0.2, -0.1, 0.3), (2.0, -3.0, -5.0), (1.0, -2.0, 0.5), [1100, 1300, 1250, 900], (0.1, -0.2, 0.3, 0.9))
    v_body = np.array(vectors.rotate_back(at.q, at.v))
    motion = Motion(*map(np.array, (at.p, at.q)), v_body, np.array(at.w), np.array(at.rotor_speed), np.zeros(4))
    own = plant.plant_of(described, polynomial.summands_of([described]))
    for mine, other in zip(
        plant.wrench(at, tuple(v_body), (0.0,) * 4, (0.0,) * 4, own), registry.wrench(motion, parameters), strict=True
    ):
        assert np.array(mine) == pytest.approx(np.asarray(other), rel=1e-6)
