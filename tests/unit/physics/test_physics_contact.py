"""Contact: flights that rest, land, fall, pass through a gate or hit its frame."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from free_flight import at, fly, parameters, profile, steady, track, vehicle, world

from swift_ros import geometry
from swift_ros.race import judge as race
from swift_ros.track import to_gate_frame
from swift_ros.types import Odometry
from swift_ros.vehicle import GRAVITY
from swift_sim_bridge.physics import contact
from swift_sim_bridge.physics.state import stacked, unstacked
from swift_sim_bridge.simulation import simulator
from swift_sim_bridge.simulation.simulator import FlightModel

IDLE = steady(np.zeros(3), 0.0, 50)
frame_distance = jax.jit(contact.frame_distance)


@jax.jit
def resolve(state, parameters, world, dt):
    moved, touched = contact.resolve(unstacked(state), parameters, world, dt)
    return stacked(moved), touched


@pytest.fixture(autouse=True)
def double_precision():
    with jax.enable_x64(True):
        yield


def test_a_vehicle_rests_on_its_podium_and_its_accelerometer_measures_gravity():
    p_world, q_world_body = track().start_pose
    for armed in (False, True):
        flight, trace = fly(at(p_world, q_world_body), *IDLE, FlightModel(parameters(), profile(), world()), armed)
        assert np.allclose(flight.state.p_world, p_world, atol=1e-9)
        assert np.allclose(trace.specific_force_body, [0.0, 0.0, GRAVITY], atol=1e-6)
        assert trace.contact.supported.all() and not trace.contact.crashed.any()
        assert (flight.state.rotor_speed.max() > 0) == armed


def test_a_vehicle_climbs_off_its_podium_and_lands_beside_it():
    p_world, q_world_body = track().start_pose
    climb = steady(np.zeros(3), 0.6, 50)
    flight, trace = fly(at(p_world, q_world_body), *climb, FlightModel(parameters(), profile(), world()))
    assert flight.state.p_world[2] > p_world[2] + 0.5 and not trace.contact.supported[-1].any()
    low = at((8.0, 0.0, 0.5 * vehicle().hull_height + 0.05))
    flight, trace = fly(low, *IDLE, FlightModel(parameters(), profile(), world()), armed=False)
    assert flight.state.p_world[2] == pytest.approx(0.5 * vehicle().hull_height, abs=1e-9)
    assert not trace.contact.crashed.any()


def test_a_fall_is_a_crash_that_creates_no_energy():
    start = at((8.0, 0.0, 2.0), v_world=(4.0, 0.0, 0.0), omega_body=(3.0, 1.0, 0.0))
    flight, trace = fly(
        start, *steady(np.zeros(3), 0.0, 150), FlightModel(parameters(), profile(), world()), armed=False
    )
    assert trace.contact.crashed.any()
    assert trace.contact.impact.max() == pytest.approx(np.sqrt(2 * GRAVITY * 1.9), rel=0.05)
    turning = 0.5 * np.einsum("...i,ij,...j", trace.omega_body, vehicle().inertia_matrix, trace.omega_body)
    flying = vehicle().mass * (0.5 * np.sum(trace.v_world**2, axis=-1) + GRAVITY * trace.p_world[..., 2])
    assert np.diff((turning + flying).ravel()).max() < 0.02  # J a step: the integrator's own error
    assert np.allclose(flight.state.v_world, 0.0, atol=1e-6) and np.allclose(flight.state.omega_body, 0.0, atol=1e-3)


def test_a_vehicle_that_tilts_on_its_podium_rises_with_its_velocity():
    """Full roll while the thrust rises: the hull stands on its rim, and its height is the integral of its velocity.

    The torque of one step turns the hull before the contact pushes back, which lifts it by some millimetres.
    """
    p_world, q_world_body = track().start_pose
    rolling = steady(np.array([6.0, 0.0, 0.0]), 0.3, 25)
    flight, trace = fly(at(p_world, q_world_body), *rolling, FlightModel(parameters(), profile(), world()))
    heights, speeds = np.ravel(trace.p_world[..., 2]), np.ravel(trace.v_world[..., 2])
    on_rim = np.ravel(trace.contact.supported)[1:]
    lifted = np.diff(heights) - 0.25 / len(heights) * speeds[1:]
    assert np.sum(np.where(on_rim, np.diff(heights), 0.0)) > 0.03
    assert np.sum(np.maximum(lifted, 0.0)) < 0.01


def test_the_attitude_of_a_vehicle_that_tilts_on_its_podium_is_the_integral_of_its_rates():
    """It once turned by a seventh more than a gyro says, and in a fast take-off odometry and IMU disagreed."""
    p_world, q_world_body = track().start_pose
    rolling = steady(np.array([6.0, 3.0, 0.0]), 0.3, 25)
    flight, trace = fly(at(p_world, q_world_body), *rolling, FlightModel(parameters(), profile(), world()))
    omega = np.reshape(trace.omega_body, (-1, 3))
    assert np.sum(np.ravel(trace.contact.supported)) > 30
    q, dt = np.asarray(q_world_body), 0.25 / len(omega)
    for rate in omega:
        q = geometry.quaternion_multiply(q, geometry.quaternion_from_rotation_vector(dt * rate))
    off = geometry.quaternion_multiply(geometry.quaternion_conjugate(q), np.asarray(flight.state.q_world_body))
    turned = geometry.quaternion_multiply(geometry.quaternion_conjugate(np.asarray(q_world_body)), q)
    off_deg, turned_deg = (np.degrees(2.0 * np.arccos(min(abs(float(one[3])), 1.0))) for one in (off, turned))
    assert off_deg < 0.01 * turned_deg and turned_deg > 20.0


def test_a_flight_into_the_podium_is_a_crash_that_lifts_nothing():
    """At 15 m/s over the podium with a hull that reaches 5 cm deep: it stops there, and is not put on top."""
    p_world, _ = track().start_pose
    rolled = geometry.quaternion_from_rotation_vector(np.array([np.arcsin(0.5), 0.0, 0.0]))
    before = at(p_world + np.array([0.2, 0.0, 0.0]), rolled, v_world=(15.0, 0.0, 1.0))
    after, touched = resolve(before, parameters(), world(), 0.002)
    assert touched.crashed and touched.impact == pytest.approx(15.0)
    assert np.allclose(after.p_world, before.p_world) and np.allclose(after.v_world, 0.0)


def towards(gate, offset_y, speed=15.0):
    """Return a level state 1 m before a gate, `offset_y` m left of its centre, flying in its direction of passage."""
    position, rotation = track().positions[gate], track().rotations[gate]
    q_world_body = geometry.quaternion_from_yaw(track().yaws[gate])
    return at(position + rotation @ [-1.0, offset_y, 0.0], q_world_body, v_world=rotation @ [speed, 0.0, 0.0])


@pytest.mark.parametrize(
    ("offset", "ends"),
    [
        (0.0, "passes"),
        (0.75 - 0.18 - 0.02, "passes"),
        (0.75 - 0.18 + 0.02, "hits"),
        (-0.9, "hits"),
        (1.05 + 0.18 + 0.05, "misses"),
    ],
)
@pytest.mark.parametrize("gate", [1, 3])
def test_hits_of_the_frame_and_passages_agree_with_the_judge(gate, offset, ends):
    judge = race.Judge(replace(track(), gates=(track().gates[gate],)), vehicle().hull_radius, vehicle().hull_height)
    judge.start(0)
    flight, events, hits = towards(gate, offset), [], set()
    for tick in range(1, 26):
        flight, trace = fly(flight, *steady(np.zeros(3), 0.25, 1), FlightModel(parameters(), profile(), world()))
        hits |= set(trace.contact.gate.ravel()) - {-1}
        state = flight.state
        v_body = geometry.rotate_inverse(np.asarray(state.q_world_body), np.asarray(state.v_world))
        at_tick = (np.asarray(value) for value in (state.p_world, state.q_world_body, v_body, state.omega_body))
        events += judge.update(Odometry(tick * 10_000_000, *at_tick))
    speed = np.linalg.norm(flight.state.v_world)
    assert hits == ({gate} if ends == "hits" else set())
    assert (speed < 5.0) == (ends == "hits")
    assert any(event.state == race.CRASHED for event in events) == (ends == "hits")
    assert any(event.is_passage for event in events) == (ends == "passes")


def test_the_distance_to_a_frame_is_the_distance_of_the_nearest_points():
    """Random hulls around a gate against a dense cloud of points on the hull."""
    rng = np.random.default_rng(1000)
    quaternions = geometry.normalize(rng.normal(size=(200, 4)))
    gate = 2
    offsets = rng.uniform([-0.5, -1.4, -1.4], [0.5, 1.4, 1.4], size=(200, 3))
    centres = track().positions[gate] + offsets @ track().rotations[gate].T
    frames = world().frames
    distance, _ = frame_distance(jnp.asarray(centres), jnp.asarray(quaternions), parameters(), frames)
    cloud = hull_cloud()
    for i in range(200):
        points = centres[i] + geometry.rotate(quaternions[i], cloud)
        local = to_gate_frame(track().positions[gate], track().rotations[gate], points)
        bars = zip(frames.bar_low[gate], frames.bar_high[gate], strict=True)
        gaps = [local - np.clip(local, low, high) for low, high in bars]
        truth = min(np.linalg.norm(gap, axis=1).min() for gap in gaps)
        assert (
            truth - 0.012 < distance[i, gate] < truth + 6e-3
        )  # the cloud's spacing; the remaining error of the projections


def hull_cloud():
    angle = np.linspace(0.0, 2 * np.pi, 120, endpoint=False)
    radii, heights = np.linspace(0.0, vehicle().hull_radius, 12), 0.5 * vehicle().hull_height * np.linspace(-1, 1, 7)
    r, a, z = (grid.ravel() for grid in np.meshgrid(radii, angle, heights, indexing="ij"))
    return np.stack([r * np.cos(a), r * np.sin(a), z], axis=-1)


def test_a_contact_never_increases_the_speed():
    rng = np.random.default_rng(1001)
    edge = track().positions[2] + track().rotations[2] @ [0.0, 0.8, 0.0]
    for v_world in rng.normal(size=(20, 3)) * 8.0:
        before = at(edge, v_world=v_world, omega_body=(1.0, 2.0, 3.0))
        after, touched = resolve(before, parameters(), world(), 0.002)
        assert touched.gate == 2
        assert np.linalg.norm(after.v_world) <= np.linalg.norm(v_world) + 1e-12


def test_without_a_world_there_is_no_contact():
    flight, trace = fly(towards(1, -0.9), *steady(np.zeros(3), 0.25, 25), FlightModel(parameters(), profile()))
    assert isinstance(flight, simulator.Flight)
    assert not trace.contact.crashed.any() and np.linalg.norm(flight.state.v_world) > 10.0
