"""The training environment: `n` races at once, as pure functions of arrays.

One step is one control tick of 10 ms. The action becomes a command, which reaches the simulated flight controller with
a delay; the simulator advances; the rules are applied to the true state; the policy observes an estimate. Action,
observation and the policy's own choice of the next gate are the code that flies (`swift_ros.policy`).
"""

from dataclasses import replace
from typing import NamedTuple

import jax
import jax.numpy as jnp

from swift_ros import geometry
from swift_ros.betaflight.sticks import throttle_for_thrust
from swift_ros.policy import action as actions
from swift_ros.policy import gates
from swift_ros.policy.observation import observe
from swift_ros.track import to_gate_frame
from swift_ros.vehicle import GRAVITY
from swift_sim_bridge.flight_controller.rate_loop.stick_path import ReceiverFrame
from swift_sim_bridge.pilot.episodes import judging, randomization, rewards, starts
from swift_sim_bridge.pilot.episodes.randomization import TICK, UNDISTURBED, Disturbance
from swift_sim_bridge.pilot.episodes.world import World
from swift_sim_bridge.simulation.simulator import Flight, FlightModel, advance

TRUE_OBSERVATION_SIZE = 27  # entries of the true observation without the previous action, for the critic
# Share of the estimate's error in flight with which an episode starts on the podium: there the odometry has just been
# aligned with the map.
INITIAL_ERROR_SHARE = 0.2
COMMANDS = 3  # last commands that a training keeps; delays reach one less, ticks


class Agents(NamedTuple):
    """The state of `n` races, all with leading (n,).

    Attributes:
        flight: state of the simulator.
        episode: what was drawn for the episode.
        error: errors of the state estimate, see `randomization`.
        voltage: V, of the battery.
        gate: index of the next gate.
        pilot_gate: index of the next gate by the estimate.
        taking_off: the episode began on the podium, and no gate was passed.
        p_estimate: (n, 3) m, estimated position.
        commands: (n, c, 4), the last commands (omega 3 rad/s, thrust m/s^2), newest first.
        previous_action: (n, 4).
        age: ticks since the start of the episode.
        since_passage: ticks.
        passages: gates passed in this episode.
        pending: (n, k), the flight at the last passage; it enters the bank after the next passage.
        pending_gate: the gate of that passage; the number of gates if there was none.
    """

    flight: Flight
    episode: randomization.Episode
    error: jnp.ndarray
    voltage: jnp.ndarray
    gate: jnp.ndarray
    pilot_gate: jnp.ndarray
    taking_off: jnp.ndarray
    p_estimate: jnp.ndarray
    commands: jnp.ndarray
    previous_action: jnp.ndarray
    age: jnp.ndarray
    since_passage: jnp.ndarray
    passages: jnp.ndarray
    pending: jnp.ndarray
    pending_gate: jnp.ndarray


class Outcome(NamedTuple):
    """What a step ended in, all (n,).

    Attributes:
        reward: of the step.
        terms: of the reward, by name.
        done: the episode ended as crashed, missed or stuck.
        timeout: the episode ran out of time.
        passed: the next gate was passed.
        crashed: a frame was touched or the flight volume left.
        missed: the next gate was missed.
        margin: m, hull to inner edge at a passage.
    """

    reward: jnp.ndarray
    terms: dict[str, jnp.ndarray]
    done: jnp.ndarray
    timeout: jnp.ndarray
    passed: jnp.ndarray
    crashed: jnp.ndarray
    missed: jnp.ndarray
    margin: jnp.ndarray


class Conditions(NamedTuple):
    """How episodes begin, and what they are made of.

    Attributes:
        difficulty: 0..1, see `randomization`.
        podium_share: probability of a start on the podium; else the start is around a state of the bank.
        commands: last commands that are kept; longer delays need more.
        by: what differs from a training.
    """

    difficulty: jnp.ndarray
    podium_share: float = 1.0
    commands: int = COMMANDS
    by: Disturbance = UNDISTURBED


def reset(world: World, bank, key, n: int, conditions: Conditions) -> Agents:
    """Return `n` new episodes.

    Args:
        world: constants of the training.
        bank: (g, size, k), see `starts`.
        key: of the random numbers.
        n: number of episodes.
        conditions: of the episodes.
    """
    keys = jax.random.split(key, 6)
    from_start = jax.random.uniform(keys[0], (n,)) < conditions.podium_share
    from_bank, gate_passed = starts.from_bank(world, bank, keys[1], n)
    flight = starts.choose(from_start, starts.podium(world, keys[2], n), from_bank)
    gate_count = world.gates.positions.shape[0]
    gate = jnp.where(from_start, 0, (gate_passed + 1) % gate_count)
    drawn = randomization.draw_episode(keys[3], n, conditions.difficulty, world.errors, world.settings)
    episode = randomization.disturbed(drawn, conditions.by)
    charge = episode.charge_share * world.vehicle.battery.capacity
    flight = replace(flight, state=replace(flight.state, charge=charge))
    error = randomization.initial_error(keys[4], episode)
    error = jnp.where(from_start[:, None], INITIAL_ERROR_SHARE * error, error)
    rest = jnp.array([0.0, 0.0, 0.0, 0.0], jnp.float32)
    hover = jnp.array([0.0, 0.0, 0.0, GRAVITY], jnp.float32)
    command = jnp.where(from_start[:, None], rest, hover)
    idle_action = actions.from_command(command[:, 3], command[:, :3], world.max_thrust, world.max_rates)
    p_estimate, _, _ = randomization.estimate(error, *pose_and_velocity(flight))
    zero = jnp.zeros((n,), jnp.int32)
    return Agents(
        flight=flight,
        episode=episode,
        error=error,
        voltage=jnp.full((n,), world.vehicle.battery.reference_voltage, jnp.float32),
        gate=gate,
        pilot_gate=gate,
        taking_off=from_start,
        p_estimate=p_estimate,
        commands=jnp.repeat(command[:, None], conditions.commands, axis=1),
        previous_action=idle_action,
        age=zero,
        since_passage=zero,
        passages=zero,
        pending=starts.pack(flight),
        pending_gate=jnp.full((n,), gate_count, jnp.int32),
    )


def pose_and_velocity(flight: Flight):
    """Return true (p_world, q_world_body, v_world)."""
    return flight.state.p_world, flight.state.q_world_body, flight.state.v_world


def observations(world: World, agents: Agents):
    """Return the observations of the policy (n, 31) and of the critic (n, 58), which also gets the true state."""
    p, q, v = pose_and_velocity(agents.flight)
    p_estimate, q_estimate, v_estimate = randomization.estimate(agents.error, p, q, v)
    corners = world.corners[agents.pilot_gate]
    policy = observe(p_estimate, v_estimate, q_estimate, corners, agents.previous_action)
    true = observe(p, v, q, world.corners[agents.gate], agents.previous_action)
    return policy, jnp.concatenate([policy, true[:, :TRUE_OBSERVATION_SIZE]], axis=-1)


def fly(world: World, agents: Agents, action, innovation) -> tuple[Agents, jnp.ndarray]:
    """Fly one tick: delayed command, simulator, state estimate, the policy's next gate.

    Returns:
        The agents after the tick, without verdict and reward, and the body rates commanded (n, 3) rad/s.
    """
    thrust, omega = actions.to_command(action, world.max_thrust, world.max_rates)
    newest = jnp.concatenate([omega, thrust[:, None]], axis=-1)
    commands = jnp.concatenate([newest[:, None], agents.commands[:, :-1]], axis=1)
    delayed = delayed_command(commands, agents.episode.delay_ticks)
    voltage = agents.voltage + agents.episode.voltage_error
    throttle = throttle_for_thrust(delayed[:, 3], voltage, world.vehicle, world.profile.motor_idle)
    armed = jnp.ones(throttle.shape, bool)
    parameters = randomization.parameters_of(agents.episode, world.parameters)
    frame = ReceiverFrame(delayed[:, :3], throttle, armed)
    flight, trace = advance(agents.flight, frame, FlightModel(parameters, world.profile, world.supports))
    error = randomization.next_error(innovation, agents.error, agents.episode)
    p_estimate, _, _ = randomization.estimate(error, *pose_and_velocity(flight))
    frames = world.gates.positions, world.gates.rotations, world.gates.outer_sides
    pilot_gate, _ = gates.advance(agents.pilot_gate, *frames, agents.p_estimate, p_estimate)
    moved = agents._replace(
        flight=flight,
        error=error,
        voltage=trace.voltage[-1],
        pilot_gate=pilot_gate,
        p_estimate=p_estimate,
        commands=commands,
        previous_action=action,
        age=agents.age + 1,
    )
    return moved, omega


def delayed_command(commands, delay_ticks):
    """Return the command (n, 4) in force during the tick.

    A delay of a part of a tick is the weighted mean of two commands.

    Args:
        commands: (n, c, 4), newest first.
        delay_ticks: (n,), 0 to c - 1.
    """
    weights = jnp.maximum(1.0 - jnp.abs(jnp.arange(commands.shape[1]) - delay_ticks[:, None]), 0.0)
    return jnp.sum(weights[..., None] * commands, axis=1)


def step(
    world: World, agents: Agents, action, innovation, scales: dict, guide_reach_m: float | jnp.ndarray = jnp.inf
) -> tuple[Agents, Outcome]:
    """Return (agents after one tick, outcome). A finished episode is not reset here.

    Args:
        world: constants of the training.
        agents: before the tick.
        action: (n, 4) in [-1, 1].
        innovation: (n, 9), see `randomization.next_error`.
        scales: of the terms of the reward.
        guide_reach_m: distance from the guide at which the episode ends.
    """
    settings = world.settings
    moved, omega = fly(world, agents, action, innovation)
    p_before, p_after = agents.flight.state.p_world, moved.flight.state.p_world
    verdict = judging.judge(world.gates, agents.gate, p_before, moved.flight.state, settings.missed_window_m)
    in_podium = verdict.in_podium & ~agents.taking_off
    touched = (verdict.touched | in_podium) & (agents.age >= settings.grace_s / TICK)
    since_passage = jnp.where(verdict.passed, 0, agents.since_passage + 1)
    stuck = since_passage >= settings.stuck_s / TICK
    crashed = touched | verdict.outside
    timeout = moved.age >= settings.episode_s / TICK
    gate = jnp.where(verdict.passed, (agents.gate + 1) % world.gates.positions.shape[0], agents.gate)
    guide_before, guide_after = (on_guide(world, place, agents.gate) for place in (p_before, p_after))
    done = crashed | verdict.missed | stuck | (guide_after.distance >= guide_reach_m)
    position, rotation = world.gates.positions[agents.gate], world.gates.rotations[agents.gate]
    width = settings.opening_half_width_m
    moment = rewards.Moment(
        distance_before=rewards.distance_to_opening(to_gate_frame(position, rotation, p_before), width),
        distance_after=rewards.distance_to_opening(to_gate_frame(position, rotation, p_after), width),
        gate_angle=gate_angle(world, moved.flight.state, gate),
        omega_command=omega,
        action=action,
        previous_action=agents.previous_action,
        crashed=done,
        passed=verdict.passed,
        missed=verdict.missed,
        margin=verdict.margin,
        height=verdict.height,
        beside=verdict.beside,
        off_guide=jnp.maximum(guide_after.distance - settings.guide_free_m, 0.0),
        guide_time=guide_before.time_to_gate - guide_after.time_to_gate,
        thrust_cosine=thrust_cosine(moved.flight.state, guide_after.thrust_axis),
    )
    moved = moved._replace(
        gate=gate,
        taking_off=agents.taking_off & ~verdict.passed,
        since_passage=since_passage,
        passages=agents.passages + verdict.passed,
    )
    terms = rewards.weighted(moment, scales)
    outcome = Outcome(
        reward=sum(terms.values(), jnp.zeros(())),
        terms=terms,
        done=done,
        timeout=timeout & ~done,
        passed=verdict.passed,
        crashed=crashed,
        missed=verdict.missed,
        margin=verdict.margin,
    )
    return moved, outcome


class OnGuide(NamedTuple):
    """Where places are along the guide.

    Attributes:
        time_to_gate: (n,) s, that the guide takes to the gate; 0 without a guide.
        distance: (n,) m, from the guide; 0 without one.
        thrust_axis: (n, 3), unit vector of its thrust in the world; zero without one.
    """

    time_to_gate: jnp.ndarray
    distance: jnp.ndarray
    thrust_axis: jnp.ndarray


def on_guide(world: World, p_world, gate) -> OnGuide:
    """Return where places (n, 3) m on the way to the gates (n,) are along the guide."""
    guide = world.guide
    if guide is None:
        nothing = jnp.zeros(p_world.shape, p_world.dtype)
        return OnGuide(nothing[:, 0], nothing[:, 0], nothing)
    offset = p_world[:, None] - jnp.asarray(guide.points, jnp.float32)[gate]
    squares = jnp.sum(offset**2, axis=-1)
    nearest = jnp.argmin(squares, axis=-1)
    offset = jnp.take_along_axis(offset, nearest[:, None, None], axis=1)[:, 0]
    velocity, axis, left = (
        jnp.asarray(values, jnp.float32)[gate, nearest]
        for values in (guide.velocities, guide.thrust_axes, guide.time_to_gate)
    )
    ahead = jnp.sum(offset * velocity, axis=-1) / (jnp.sum(velocity**2, axis=-1) + 1.0)  # 1: at rest on the podium
    return OnGuide(left - ahead, jnp.sqrt(jnp.min(squares, axis=-1) + 1e-9), axis)


def thrust_cosine(state, thrust_axis):
    """Return the cosine (n,) of the angle between the thrust and an axis (n, 3) in the world; 1 where that is zero."""
    up = jnp.broadcast_to(jnp.array([0.0, 0.0, 1.0]), thrust_axis.shape)
    aligned = jnp.sum(geometry.rotate(state.q_world_body, up) * thrust_axis, axis=-1)
    return jnp.where(jnp.any(thrust_axis != 0.0, axis=-1), aligned, 1.0)


def gate_angle(world: World, state, gate):
    """Return the angle (n,) rad between the camera's optical axis and the centre of the next gate."""
    to_gate = geometry.normalize(world.gates.positions[gate] - state.p_world)
    axis = geometry.rotate(state.q_world_body, jnp.broadcast_to(world.camera_axis, to_gate.shape))
    return jnp.arccos(jnp.clip(jnp.sum(axis * to_gate, axis=-1), -0.999999, 0.999999))


def commit(world: World, agents: Agents, earned: starts.Earned, gate_before, passed) -> tuple[Agents, starts.Earned]:
    """Return (agents, earned states) after a tick: a state is earned when the next gate is passed as well.

    Args:
        world: constants of the training.
        agents: after the tick.
        earned: states that may enter the bank.
        gate_before: (n,), next gate before the tick.
        passed: (n,) bool, it was passed.
    """
    is_earned = passed & (agents.pending_gate < world.gates.positions.shape[0])
    earned = starts.choose(is_earned, starts.Earned(agents.pending, agents.pending_gate), earned)
    pending = jnp.where(passed[:, None], starts.pack(agents.flight), agents.pending)
    pending_gate = jnp.where(passed, gate_before, agents.pending_gate)
    return agents._replace(pending=pending, pending_gate=pending_gate), earned
