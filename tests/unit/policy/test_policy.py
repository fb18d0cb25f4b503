"""The pilot: observations equal to those of training, count of gates, and invalid inputs."""

import jax.numpy as jnp
import numpy as np
import pytest
from onnx import TensorProto, helper

from swift_ros import configuration, geometry
from swift_ros.errors import UsageError
from swift_ros.policy import action as actions
from swift_ros.policy import gates
from swift_ros.policy.actor import Actor
from swift_ros.policy.observation import SIZE, observe
from swift_ros.policy.pilot import IDLE_ACTION, Pilot
from swift_ros.track import Track
from swift_ros.types import Odometry
from swift_ros.vehicle import Vehicle

FOLDER = configuration.configuration_folder()
TRACK = configuration.load(Track, FOLDER / "track.yaml")
VEHICLE = configuration.load(Vehicle, FOLDER / "drone.yaml")
LEVEL = np.array([0.0, 0.0, 0.0, 1.0])
RACE_NS = 1_000_000_000


class FixedActor:
    """Returns the same raw action for every observation."""

    def __init__(self, raw):
        self.raw = np.array(raw, dtype=np.float32)

    def act(self, observation):
        return self.raw


def state_at(position, stamp_ns=RACE_NS, attitude=LEVEL, velocity=(0.0, 0.0, 0.0)):
    return Odometry(stamp_ns, np.array(position, float), attitude, np.array(velocity, float), np.zeros(3))


def racing_pilot(actor):
    pilot = Pilot(actor, TRACK, VEHICLE)
    pilot.announce(RACE_NS, "racing")
    return pilot


def lap_points(offset=(0.0, 0.0)):
    """Yield points before and behind every gate, with an offset (left, up) from its centre, m."""
    for position, rotation in zip(TRACK.positions, TRACK.rotations, strict=True):
        for x in (-0.4, 0.4):
            yield position + rotation @ np.array([x, *offset])


def test_observation_is_the_same_in_numpy_and_jax():
    rng = np.random.default_rng(0)
    p, v = rng.normal(size=(5, 3)), rng.normal(size=(5, 3))
    q = geometry.normalize(rng.normal(size=(5, 4)))
    corners, action = TRACK.corners[[0, 3, 6, 1, 2]], rng.uniform(-1, 1, (5, 4))
    flight = observe(p, v, q, corners, action)
    training = observe(*(jnp.asarray(x, jnp.float32) for x in (p, v, q, corners, action)))
    assert flight.shape == (5, SIZE)
    np.testing.assert_allclose(flight, np.asarray(training), atol=2e-6)


def test_observed_corners_are_those_of_the_gate_ahead():
    gate_x = TRACK.positions[0] - np.array([3.0, 0.0, 0.0])  # gate 1 looks along +x
    corners = 10.0 * observe(gate_x, np.zeros(3), LEVEL, TRACK.corners[0], IDLE_ACTION)[15:27].reshape(4, 3)
    half = 0.5 * TRACK.inner_side
    expected = [[3, half, half], [3, -half, half], [3, -half, -half], [3, half, -half]]
    np.testing.assert_allclose(corners, expected, atol=1e-9)


def test_command_and_action_are_inverse():
    action = np.array([0.3, -0.5, 0.2, 1.0])
    thrust, omega = actions.to_command(action, 40.0, (10.0, 10.0, 4.0))
    np.testing.assert_allclose(omega, [-5.0, 2.0, 4.0])
    np.testing.assert_allclose(actions.from_command(np.asarray(thrust), omega, 40.0, (10.0, 10.0, 4.0)), action)


@pytest.mark.parametrize("offset", [(0.0, 0.0), (0.7, -0.7), (1.2, 0.3)], ids=["centre", "edge", "frame"])
def test_a_lap_is_counted_when_the_estimate_is_outside_of_the_opening(offset):
    pilot = racing_pilot(FixedActor([0, 0, 0, 0]))
    steps = [pilot.update(state_at(p, RACE_NS + i)) for i, p in enumerate(lap_points(offset))]
    assert [step.next_gate for step in steps] == [0, 1, 1, 2, 2, 3, 3, 4, 4, 5, 5, 6, 6, 0]
    assert steps[-1].lap == 0
    assert pilot.update(state_at(TRACK.positions[0] - [0.4, 0, 0], RACE_NS + 99)).lap == 0
    assert pilot.update(state_at(TRACK.positions[0] + [0.4, 0, 0], RACE_NS + 100)).lap == 1


def test_a_passage_does_not_count_backwards_far_outside_or_in_the_wrong_order():
    before, behind = TRACK.positions[0] - [0.4, 0, 0], TRACK.positions[0] + [0.4, 0, 0]
    frame = TRACK.positions[0], TRACK.rotations[0], TRACK.outer_sides[0]
    assert gates.passed(*frame, before, behind)
    assert not gates.passed(*frame, behind, before)
    assert not gates.passed(*frame, before + [0, 2.0, 0], behind + [0, 2.0, 0])
    # Gate 5 is below gate 4 and is passed in the other direction: a passage of 4 must not count as 5.
    points = [TRACK.positions[3] + [0.4, 0, 0], TRACK.positions[3] - [0.4, 0, 0]]
    following, _ = gates.advance(
        np.array([3, 4]), TRACK.positions, TRACK.rotations, TRACK.outer_sides, *(np.stack([p, p]) for p in points)
    )
    assert following.tolist() == [4, 4]


def test_the_pilot_is_idle_until_the_announced_start():
    pilot = racing_pilot(FixedActor([0.5, 2.0, 0.0, 0.0]))
    waiting = pilot.update(state_at(TRACK.start, RACE_NS - 1))
    assert waiting.command.thrust == 0 and not waiting.command.omega_body.any()
    np.testing.assert_array_equal(waiting.action, IDLE_ACTION)
    flying = pilot.update(state_at(TRACK.start, RACE_NS))
    assert flying.command.thrust == pytest.approx(0.75 * VEHICLE.max_thrust / VEHICLE.mass)
    assert flying.command.omega_body[0] == pytest.approx(VEHICLE.rates.max[0])  # clipped
    np.testing.assert_array_equal(flying.observation[-4:], IDLE_ACTION)
    np.testing.assert_array_equal(pilot.update(state_at(TRACK.start, RACE_NS + 1)).observation[-4:], [0.5, 1, 0, 0])
    pilot.announce(RACE_NS + 2, "stopped")
    assert pilot.update(state_at(TRACK.start, RACE_NS + 2)).command.thrust == 0


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"position": [np.nan, 0, 0]}, "p_world that is not finite"),
        ({"attitude": np.array([0, 0, 0, np.inf])}, "q_world_body that is not finite"),
        ({"attitude": np.array([0, 0, 0, 0.5])}, "quaternion whose length is not one"),
    ],
)
def test_an_invalid_state_is_refused(change, sentence):
    pilot = racing_pilot(FixedActor([0, 0, 0, 0]))
    with pytest.raises(ValueError, match=sentence):
        pilot.update(state_at(**({"position": TRACK.start} | change)))


def test_an_output_of_the_network_that_is_not_finite_is_refused():
    with pytest.raises(ValueError, match="not finite"):
        racing_pilot(FixedActor([0, np.nan, 0, 0])).update(state_at(TRACK.start))


def test_the_shipped_pilot_loads_and_returns_an_action():
    action = Actor(FOLDER / "models" / "pilot.onnx").act(np.zeros(SIZE))
    assert action.shape == (4,) and np.all(np.abs(action) <= 1)


def test_an_invalid_model_is_an_error_of_one_sentence(tmp_path):
    with pytest.raises(UsageError, match="is missing; train one"):
        Actor(tmp_path / "none.onnx")
    invalid = tmp_path / "invalid.onnx"
    invalid.write_bytes(b"no model at all")
    with pytest.raises(UsageError, match="cannot be loaded"):
        Actor(invalid)
    infos = [helper.make_tensor_value_info(name, TensorProto.FLOAT, [1, 5]) for name in ("image", "gates")]
    graph = helper.make_graph([helper.make_node("Relu", ["image"], ["gates"])], "other", infos[:1], infos[1:])
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)])
    model.ir_version = 8
    other = tmp_path / "other.onnx"
    other.write_bytes(model.SerializeToString())
    with pytest.raises(UsageError, match=r"is not a pilot: it has image \[1, 5\]"):
        Actor(other)
