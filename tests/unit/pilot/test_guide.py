"""A training with a guide: the time-optimal lap of `swiftros limit`, read, started from, and kept near."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from swift_ros import configuration
from swift_ros.camera.model import Camera
from swift_ros.errors import UsageError
from swift_ros.race import limit
from swift_ros.race.limit import Limit, Times
from swift_ros.track import Track
from swift_ros.vehicle import Vehicle
from swift_sim_bridge.limit.line import Line, write_table
from swift_sim_bridge.pilot.episodes import environment, randomization, starts, time_optimal
from swift_sim_bridge.pilot.episodes import world as worlds
from swift_sim_bridge.pilot.job import read_settings

SPEED = 10.0  # m/s, along straight lines from gate to gate


def straight_line(points) -> Line:
    """Return a flight at SPEED through points (n, 3)."""
    lengths = np.linalg.norm(np.diff(points, axis=0), axis=1)
    ends = np.concatenate([[0.0], np.cumsum(lengths)]) / SPEED
    t = np.arange(0.0, ends[-1], 0.01)
    p = np.stack([np.interp(t, ends, column) for column in points.T], axis=1)
    one = np.ones((len(t), 1))
    return Line(
        t_s=t,
        p_world=p,
        v_world=np.gradient(p, t, axis=0),
        q_world_body=one * [0.0, 0.0, 0.0, 1.0],
        omega_body=one * [0.1, 0.2, 0.3],
        specific_force_body=one * [0.0, 0.0, 9.8],
        rotor_speed=one * [1000.0, 1001.0, 1002.0, 1003.0],
        voltage=16.0 * one[:, 0],
        segments_s=lengths / SPEED,
    )


@pytest.fixture(scope="module")
def track(repository):
    return configuration.load(Track, repository / "config/track.yaml")


@pytest.fixture(scope="module")
def vehicle(repository):
    return configuration.load(Vehicle, repository / "config/drone.yaml")


@pytest.fixture(scope="module")
def solved(track, vehicle, tmp_path_factory):
    """Return a folder as `swiftros limit` writes it, of straight lines from gate to gate."""
    folder = tmp_path_factory.mktemp("limit")
    gates = np.asarray(track.positions)
    lap = straight_line(np.concatenate([gates, gates[:1]]))
    race = straight_line(np.concatenate([np.asarray(track.start)[None], gates]))
    write_table(lap, folder / time_optimal.LAP)
    write_table(race, folder / time_optimal.RACE)
    times = Times(tuple(map(float, lap.segments_s)), tuple(map(float, race.segments_s)))
    limit.write(
        Limit(track.name, vehicle.name, *limit.key_of(track, vehicle), 0.0, times, times), folder / limit.FILE, ""
    )
    return folder


@pytest.fixture(scope="module")
def guided(solved, track, vehicle, repository):
    """Return a world with this guide."""
    settings = read_settings(repository / "config")
    guide = time_optimal.read_guide(solved, track, vehicle, settings.environment.bank_fixed)
    camera = configuration.load(Camera, repository / "config/camera.yaml")
    return worlds.make_world(track, vehicle, camera, settings.environment, settings.estimate_errors, guide)


def test_the_fixed_states_of_the_bank_are_on_the_lap_at_its_speed_or_slower(guided, track):
    settings = guided.settings
    bank = starts.first_bank(guided)
    for gate, rows in enumerate(bank):
        flight = starts.unpack(rows[: settings.bank_fixed], starts.podium_like(guided))
        start, end = track.positions[gate], track.positions[(gate + 1) % len(track.positions)]
        along = (end - start) / np.linalg.norm(end - start)
        offset = np.asarray(flight.state.p_world) - start
        np.testing.assert_allclose(offset - np.outer(offset @ along, along), 0.0, atol=0.03)
        assert np.all(np.diff(offset @ along) > 0)  # from this gate towards the next one
        speeds = np.linalg.norm(flight.state.v_world, axis=1)[2:-2] / SPEED  # not on the corners at the gates
        assert settings.guide_speed[0] - 1e-3 < speeds.min() and speeds.max() < settings.guide_speed[1] + 1e-3
        assert np.ptp(speeds) > 0.8 * np.ptp(settings.guide_speed)
        np.testing.assert_allclose(flight.state.rotor_speed[0], [1000.0, 1001.0, 1002.0, 1003.0])


def test_the_distance_is_to_the_way_to_the_next_gate_and_from_the_podium_too(guided, track):
    gates = track.positions
    before = jnp.asarray([0.5 * (gates[i - 1] + gates[i]) for i in range(len(gates))], jnp.float32)
    every = jnp.arange(len(gates))
    assert float(environment.on_guide(guided, before, every).distance.max()) < 0.2  # between two of its points
    start = jnp.asarray(0.5 * (track.start + gates[0]), jnp.float32)[None]
    assert float(environment.on_guide(guided, start, jnp.array([0])).distance[0]) < 0.2
    along = np.stack([gates[i] - gates[i - 1] for i in range(len(gates))])
    across = np.cross(along, np.roll(along, 1, axis=1))
    aside = before + jnp.asarray(2.0 * across / np.linalg.norm(across, axis=1, keepdims=True), jnp.float32)
    np.testing.assert_allclose(environment.on_guide(guided, aside, every).distance[1:], 2.0, atol=0.02)
    without = environment.on_guide(guided._replace(guide=None), aside, every)
    assert not any(np.any(values) for values in without)


def test_the_pace_is_the_time_that_the_guide_takes_beside_it_as_well(guided, track):
    gates, every = track.positions, jnp.arange(len(track.positions))
    way = gates - np.roll(gates, 1, axis=0)
    length, along = np.linalg.norm(way, axis=1), way / np.linalg.norm(way, axis=1, keepdims=True)
    across = np.cross(along, [0.0, 0.0, 1.0])
    for share in np.linspace(0.1, 0.9, 23):
        place = jnp.asarray(gates - (1.0 - share) * way + 0.3 * across, jnp.float32)
        time_to_gate = environment.on_guide(guided, place, every).time_to_gate
        np.testing.assert_allclose(time_to_gate[1:], ((1.0 - share) * length / SPEED)[1:], rtol=0.02, atol=0.01)


def test_leaving_the_guide_costs_and_further_away_the_episode_ends(guided):
    bank = starts.first_bank(guided)
    agents = environment.reset(guided, bank, jax.random.PRNGKey(0), 3, environment.Conditions(jnp.float32(0.0), 0.0))
    side = jnp.array([0.0, 1.0, 3.0])  # m, of the three agents
    points = jnp.asarray(guided.guide.points, jnp.float32)[agents.gate, 24]
    position = points + side[:, None] * jnp.array([0.0, 0.0, 1.0])
    state = replace(agents.flight.state, p_world=position, v_world=jnp.zeros((3, 3)))
    agents = agents._replace(flight=replace(agents.flight, state=state))
    still = jnp.zeros((3, randomization.ERRORS))
    _, outcome = environment.step(guided, agents, jnp.zeros((3, 4)), still, {"guide": 1.0}, guide_reach_m=2.0)
    assert float(outcome.reward[0]) == 0.0 > float(outcome.reward[1]) > float(outcome.reward[2])
    assert not outcome.done[:2].any() and outcome.done[2]


def test_a_guide_of_another_track_is_refused(solved, track, vehicle):
    moved = replace(track, gates=(replace(track.gates[0], position=(-1.0, -1.0, 3.0)), *track.gates[1:]))
    with pytest.raises(UsageError, match="call `swiftros limit` with their files"):
        time_optimal.read_guide(solved, moved, vehicle, 8)


def test_the_thrust_is_compared_with_that_of_the_guide_at_the_same_place(guided, track):
    place = jnp.asarray(0.5 * (track.positions[:1] + track.positions[-1:]), jnp.float32)
    axis = environment.on_guide(guided, place, jnp.array([0])).thrust_axis  # the guide flies level
    np.testing.assert_allclose(axis, [[0.0, 0.0, 1.0]], atol=1e-6)
    podium = starts.podium_like(guided).state
    for angle in (0.0, 0.6, np.pi):
        q = jnp.array([[np.sin(0.5 * angle), 0.0, 0.0, np.cos(0.5 * angle)]], jnp.float32)
        rolled = replace(podium, q_world_body=q)
        np.testing.assert_allclose(environment.thrust_cosine(rolled, axis), np.cos(angle), atol=1e-6)
    assert environment.thrust_cosine(rolled, jnp.zeros((1, 3))) == 1.0  # without a guide
