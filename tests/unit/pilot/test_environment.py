"""The training environment: rules and rewards with planted geometry, delayed commands, errors of the estimate."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from swift_ros import configuration, geometry
from swift_ros.camera.model import Camera
from swift_ros.track import Track
from swift_ros.vehicle import Vehicle
from swift_sim_bridge.physics.state import state_at_rest
from swift_sim_bridge.pilot import job
from swift_sim_bridge.pilot.episodes import environment, judging, randomization, rewards, starts
from swift_sim_bridge.pilot.episodes import world as worlds

FOLDER = configuration.configuration_folder()
SETTINGS = job.read_settings(FOLDER)
TRACK = configuration.load(Track, FOLDER / "track.yaml")
VEHICLE = configuration.load(Vehicle, FOLDER / "drone.yaml")
WORLD = worlds.make_world(
    TRACK, VEHICLE, configuration.load(Camera, FOLDER / "camera.yaml"), SETTINGS.environment, SETTINGS.estimate_errors
)
BANK = jax.jit(lambda: starts.first_bank(WORLD))()
PODIUM = jax.jit(lambda key: environment.reset(WORLD, BANK, key, 8, environment.Conditions(jnp.float32(0.0))))
EMPTY_MOMENT = rewards.Moment(
    *(jnp.zeros((1, size) if size else (1,)) for size in (0, 0, 0, 3, 4, 4, 0, 0, 0, 0, 0, 0, 0, 0, 0))
)._replace(crashed=jnp.array([False]), passed=jnp.array([False]), missed=jnp.array([False]))


def verdict_at(offset, gate=0, next_gate=0, backwards=False, attitude=(0.0, 0.0, 0.0, 1.0), step_m=0.1):
    """Return the verdict on crossing a gate's plane `offset` (left, up) m beside its centre."""
    ends = [TRACK.positions[gate] + TRACK.rotations[gate] @ np.array([x, *offset]) for x in (-step_m, step_m)]
    before, after = (jnp.asarray(p, jnp.float32)[None] for p in (reversed(ends) if backwards else ends))
    state = state_at_rest(after, jnp.asarray(attitude, jnp.float32)[None])
    verdict = judging.judge(WORLD.gates, jnp.array([next_gate]), before, state, 8.0)
    return judging.Verdict(*(np.asarray(value)[0] for value in verdict))


def test_a_flight_through_the_opening_is_a_passage_with_its_margin():
    verdict = verdict_at((0.2, 0.1))
    assert verdict.passed and not verdict.touched and not verdict.missed
    assert verdict.margin == pytest.approx(0.75 - 0.2 - VEHICLE.hull_radius, abs=1e-3)


@pytest.mark.parametrize(
    ("offset", "beside_m"),
    [((0.0, 0.0), 0.75 - 0.18), ((0.9, 0.0), -0.05 - 0.18), ((0.0, 1.05 + 0.05 + 0.4), 0.4), ((0.4, 0.6), 0.1)],
)
def test_other_frames_than_the_next_are_beside_the_way(offset, beside_m):
    """Level in the plane of gate 3, on the way from gate 5 to 6; on the way to or from gate 3 it is not beside."""
    assert verdict_at(offset, gate=2, next_gate=5, step_m=0.0).beside == pytest.approx(beside_m, abs=1e-3)
    for next_gate in (2, 3):
        assert verdict_at(offset, gate=2, next_gate=next_gate, step_m=0.0).beside > 1.0


def test_a_hull_rolled_by_90_degrees_needs_more_height():
    rolled = geometry.quaternion_from_rotation_vector(np.array([np.pi / 2, 0.0, 0.0]))
    assert verdict_at((0.0, 0.6)).passed
    verdict = verdict_at((0.0, 0.6), attitude=rolled)
    assert verdict.touched and not verdict.passed


@pytest.mark.parametrize(
    ("offset", "backwards", "touched", "missed"),
    [
        ((0.65, 0.0), False, True, True),
        ((0.9, 0.9), True, True, False),
        ((2.0, 0.0), False, False, True),
        ((2.0, 0.0), True, False, False),
        ((0.0, 0.0), True, False, False),
    ],
    ids=["edge", "corner from behind", "beside", "beside from behind", "back through"],
)
def test_a_crossing_outside_the_opening_or_backwards_is_no_passage(offset, backwards, touched, missed):
    verdict = verdict_at(offset, backwards=backwards)
    assert (bool(verdict.passed), bool(verdict.touched), bool(verdict.missed)) == (False, touched, missed)


def test_another_gate_may_be_flown_through_but_not_touched():
    assert not verdict_at((0.0, 0.0), gate=2).touched and not verdict_at((0.0, 0.0), gate=2).missed
    assert verdict_at((0.8, 0.0), gate=2).touched


@pytest.mark.parametrize("position", [(0.0, 0.0, 0.04), (0.0, 0.0, 8.1), (-15.1, 3.0, 2.0), (0.0, 15.1, 2.0)])
def test_below_the_ground_or_beyond_the_bounds_is_outside(position):
    state = state_at_rest(jnp.asarray([position], jnp.float32), jnp.array([[0.0, 0.0, 0.0, 1.0]]))
    assert judging.judge(WORLD.gates, jnp.array([0]), state.p_world, state, 8.0).outside[0]


@pytest.mark.parametrize(
    ("above_m", "taking_off", "touched"), [(-0.02, False, True), (0.02, False, False), (-0.02, True, False)]
)
def test_a_flight_into_the_podium_is_a_touch_and_a_take_off_from_it_is_not(above_m, taking_off, touched):
    agents = jax.tree.map(lambda leaf: leaf[:1], PODIUM(jax.random.PRNGKey(0)))
    position = WORLD.start[0] + jnp.array([[0.4, 0.0, above_m]])
    state = replace(agents.flight.state, p_world=position, v_world=jnp.array([[-15.0, 0.0, 0.0]]))
    agents = agents._replace(
        flight=replace(agents.flight, state=state), taking_off=jnp.array([taking_off]), age=jnp.array([9])
    )
    _, outcome = environment.step(
        WORLD, agents, jnp.zeros((1, 4)), jnp.zeros((1, randomization.ERRORS)), {"crash": 1.0}
    )
    assert outcome.crashed[0] == touched


@pytest.mark.parametrize(("above_m", "turns"), [(0.0, False), (1.0, True)])
def test_a_hull_that_stands_on_the_podium_cannot_turn_before_its_thrust_lifts_it(above_m, turns):
    """At full pitch rate the pilot of a training that ignores the podium is 0.02 s ahead of a race."""
    agents = jax.tree.map(lambda leaf: leaf[:1], PODIUM(jax.random.PRNGKey(0)))
    state = replace(agents.flight.state, p_world=agents.flight.state.p_world.at[:, 2].add(above_m))
    agents = agents._replace(flight=replace(agents.flight, state=state))
    for _ in range(5):
        agents, outcome = environment.step(
            WORLD, agents, jnp.array([[1.0, 0.0, 1.0, 0.0]]), jnp.zeros((1, randomization.ERRORS)), {"crash": 1.0}
        )
        assert not outcome.crashed[0]
    assert bool(agents.flight.state.omega_body[0, 1] > 4.0) == turns


def test_each_reward_term_has_the_value_of_a_planted_moment():
    moment = EMPTY_MOMENT._replace(
        distance_before=jnp.array([3.0]),
        distance_after=jnp.array([2.8]),
        gate_angle=jnp.array([0.5]),
        omega_command=jnp.array([[2.0, 3.0, -6.0]]),
        action=jnp.array([[0.5, 0, 0, 0]]),
        crashed=jnp.array([True]),
        passed=jnp.array([True]),
        margin=jnp.array([0.1]),
        height=jnp.array([0.06]),
        beside=jnp.array([0.08]),
        off_guide=jnp.array([0.7]),
        guide_time=jnp.array([0.012]),
        thrust_cosine=jnp.array([0.25]),
    )
    expected = {
        "progress": 0.2,
        "perception": np.exp(-10 * 0.5**4),
        "rates": -7.0,
        "smoothness": -0.25,
        "crash": -1.0,
        "passage": 1.0,
        "margin": -0.3,
        "risk": -np.exp(-5.0) - np.exp(-3.0) - np.exp(-4.0),
        "guide": -0.7,
        "pace": 0.012,
        "thrust_direction": -0.75,
        "yaw": -36.0,
    }
    assert set(expected) == set(rewards.TERMS)
    for name, value in expected.items():
        assert float(rewards.TERMS[name](moment)[0]) == pytest.approx(value, abs=1e-6), name
    weighted = rewards.weighted(moment, {"progress": 2.0, "crash": 5.0})
    assert {name: float(term[0]) for name, term in weighted.items()} == {"progress": pytest.approx(0.4), "crash": -5.0}


def test_the_risk_has_the_same_slope_on_both_sides_of_a_frame_and_of_the_ground():
    def cost(**moment):
        far = {name: jnp.array([9.0]) for name in ("margin", "height", "beside")}
        far = EMPTY_MOMENT._replace(missed=jnp.array([True]), **far)
        return float(rewards.risk(far._replace(**{name: jnp.array([way]) for name, way in moment.items()}))[0])

    for name in ("margin", "height", "beside"):
        inside, at, outside = (cost(**{name: way}) for way in (0.001, 0.0, -0.001))
        assert at == pytest.approx(-1.0)
        assert at - outside == pytest.approx(0.05, rel=1e-3) and inside - at == pytest.approx(0.05, rel=0.03)
        assert cost(**{name: -0.5}) == cost(**{name: -0.3})


def test_the_distance_is_measured_to_the_opening_not_to_its_centre():
    points = jnp.array([[-3.0, 0.3, -0.3], [-3.0, 4.4, 0.0], [-3.0, 0.0, -4.4]])
    np.testing.assert_allclose(rewards.distance_to_opening(points, 0.4), [3.0, 5.0, 5.0], rtol=1e-5)


def test_the_gate_is_in_the_middle_of_the_image_when_the_camera_points_at_it():
    up = np.tan(np.radians(20.0))  # the camera's pitch in config/camera.yaml
    below = jnp.asarray(TRACK.positions[0] - [3.0, 0.0, 3.0 * up], jnp.float32)[None]
    level = state_at_rest(below, jnp.array([[0.0, 0.0, 0.0, 1.0]]))
    assert float(environment.gate_angle(WORLD, level, jnp.array([0]))[0]) < 2e-3


def test_a_delayed_command_is_an_earlier_one_or_a_mean_of_two():
    commands = jnp.arange(3.0)[None, :, None] * jnp.ones((1, 3, 4))
    for delay in (0.0, 0.5, 1.0, 1.5):
        assert float(environment.delayed_command(commands, jnp.array([delay]))[0, 0]) == pytest.approx(delay)


def test_episodes_without_difficulty_are_nominal_and_others_have_the_stated_errors():
    key = jax.random.PRNGKey(0)
    errors, late = SETTINGS.estimate_errors, replace(SETTINGS.environment, command_delay_s=0.015, used_charge=0.2)
    easy = randomization.draw_episode(key, 4, jnp.float32(0.0), errors, late)
    assert not easy.error_scale.any() and not easy.delay_ticks.any()
    assert randomization.parameters_of(easy, WORLD.parameters).mass[2] == pytest.approx(VEHICLE.mass)
    hard = randomization.draw_episode(key, 2000, jnp.float32(1.0), errors, late)
    assert 0.19 < hard.charge_share.max() <= 0.2
    assert hard.delay_ticks.min() >= 0 and hard.delay_ticks.max() <= 1.5 and np.ptp(hard.thrust_factor) > 0.08
    error = randomization.initial_error(key, hard)
    for i in range(60):
        error = randomization.next_error(jax.random.normal(jax.random.fold_in(key, i), error.shape), error, hard)
    spread = np.std(np.asarray(error) / np.asarray(hard.error_scale), axis=0)
    np.testing.assert_allclose(spread, 1.0, atol=0.08)  # stationary


def test_a_hover_command_hovers_and_without_errors_policy_and_critic_observe_the_same():
    agents = PODIUM(jax.random.PRNGKey(1))
    hover = 2.0 * 9.80665 / WORLD.max_thrust - 1.0
    action = jnp.tile(jnp.array([hover, 0.0, 0.0, 0.0]), (8, 1))
    height = agents.flight.state.p_world[:, 2]
    still = jnp.zeros((8, randomization.ERRORS))
    step = jax.jit(lambda a: environment.step(WORLD, a, action, still, {"progress": 1.0}))
    for _ in range(100):
        agents, outcome = step(agents)
    assert not outcome.done.any()
    # The rotors spin up from idle: after a second the vehicle has sunk a little and is nearly still.
    np.testing.assert_allclose(agents.flight.state.p_world[:, 2], height, atol=0.6)
    assert np.abs(agents.flight.state.v_world).max() < 0.7
    policy, critic = environment.observations(WORLD, agents)
    np.testing.assert_allclose(policy[:, :27], critic[:, 31:], atol=1e-6)  # without errors the policy gets the truth


def test_a_state_enters_the_bank_only_after_the_next_gate_and_although_the_flight_ends_there():
    agents, nothing = PODIUM(jax.random.PRNGKey(2)), starts.nothing_earned(BANK, 8)
    gate, passed = jnp.full((8,), 2), jnp.arange(8) == 0
    agents, after_one = environment.commit(WORLD, agents, nothing, gate, passed)
    np.testing.assert_array_equal(starts.store(BANK, after_one, jax.random.PRNGKey(3), 32), BANK)
    flown = replace(agents.flight, state=replace(agents.flight.state, p_world=agents.flight.state.p_world + 5.0))
    _, after_two = environment.commit(WORLD, agents._replace(flight=flown), after_one, gate + 1, passed)
    _, after_end = environment.commit(WORLD, PODIUM(jax.random.PRNGKey(4)), after_two, jnp.zeros((8,), int), passed)
    stored = np.asarray(starts.store(BANK, after_end, jax.random.PRNGKey(5), 32))
    changed = np.argwhere(np.any(stored != np.asarray(BANK), axis=-1))
    assert changed.shape == (1, 2) and changed[0, 0] == 2 and changed[0, 1] >= 32  # of gate 3, the earlier passage
    np.testing.assert_array_equal(stored[tuple(changed[0])], agents.pending[0])
