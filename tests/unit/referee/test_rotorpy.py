"""RotorPy's flights: hidden effects act there as in the referee's own simulator."""

from dataclasses import replace

import jax
import numpy as np
import pytest

from swift_sim_bridge.referee import cases
from swift_sim_bridge.referee.simulator import flight, instruments, paths, plant, rotorpy_flight, vectors
from swift_sim_bridge.referee.simulator.rotorpy_flight import EFFECTS_OF_ROTORPY

pytest.importorskip("rotorpy")


def case(effect: str) -> cases.Case:
    return cases.draw_case("single", 2, effect, 10.0, for_rotorpy=True)


@pytest.mark.parametrize("effect", EFFECTS_OF_ROTORPY)
def test_an_effect_accelerates_rotorpy_s_vehicle_as_it_does_the_referee_s(effect):
    content = case(effect).order.content
    wind = content["terms"].get("wind", {}).get("velocity", [0.0] * 3)
    q = np.array([0.1, -0.2, 0.3, 0.9]) / np.linalg.norm([0.1, -0.2, 0.3, 0.9])
    state = {
        "x": np.array([1.0, 2.0, 30.0]),
        "q": q,
        "v": np.array([6.0, -3.0, 2.0]),
        "w": np.array([2.0, -1.0, 3.0]),
        "wind": np.array(wind),
        "rotor_speeds": np.array([1000.0, 1300.0, 1200.0, 900.0]),
    }
    u = 0.4
    control = {"cmd_motor_speeds": np.full(4, u * content["rotor_speed_range"][1])}
    theirs = rotorpy_flight.multirotor(rotorpy_flight.parameters_of(content)).statedot(state, control, 0.002)
    nothing = (0.0,) * 3
    with jax.enable_x64(True):
        ours = plant.State(*(tuple(state[key]) for key in ("x", "q", "v", "w", "rotor_speeds")), 0.0, 0.0)
        held = plant.Inputs((u,) * 4, nothing, nothing, nothing, (0.0,) * 4)
        slope, _ = plant.derivative(ours, held, plant.plant_of(content))
    np.testing.assert_allclose(slope.v, theirs["vdot"], atol=1e-9)
    np.testing.assert_allclose(slope.w, theirs["wdot"], atol=1e-8)


def test_a_flight_follows_its_path_and_is_recorded_without_a_battery():
    short = {name: values[:60] for name, values in vars(case("rotor_drag").order.path).items()}
    order = replace(case("rotor_drag").order, path=paths.Path(**short))
    flown = rotorpy_flight.fly(order)
    assert np.linalg.norm(flown.p[::5] - order.path.p, axis=1).max() < 0.3
    np.testing.assert_allclose(np.gradient(flown.p, flight.LOOP_S, axis=0)[1:-1], flown.v[1:-1], atol=1e-3)
    upwards = np.stack(vectors.rotate(flown.q.T, flown.specific_force.T), axis=1) - [0.0, 0.0, plant.GRAVITY]
    np.testing.assert_allclose(np.gradient(flown.v, flight.LOOP_S, axis=0)[5:-5], upwards[5:-5], atol=0.1)
    assert not {"voltage", "current"} & set(case("mass").channels)
    accelerometer = instruments.accelerometer(flown, {"accel_bias": {"bias": [0.1, 0.0, 0.0]}})
    np.testing.assert_allclose(accelerometer[:, 0] - flown.specific_force[:, 0], 0.1)
