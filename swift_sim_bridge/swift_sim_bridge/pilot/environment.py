"""The race as training sees it: `n` vehicles on the track at once, as pure functions of arrays.

One step is one control tick of 10 ms: the action becomes a command as in flight, reaches the simulated flight
controller late, the simulator advances, the judge looks at the truth, the pilot sees an estimate. The pilot's own
next-gate logic, the observation and the meaning of an action are the flying ones.
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
from swift_sim_bridge.pilot import judging, randomization, rewards, starts
from swift_sim_bridge.pilot.randomization import TICK
from swift_sim_bridge.pilot.world import World
from swift_sim_bridge.simulation.simulator import Flight, FlightModel, advance


class Agents(NamedTuple):
    """The state of `n` races, all leading (n,). `gate`: truly next; `pilot_gate`: next as the pilot thinks;
    `commands` (n, 3, 4): the last three commands (omega 3, thrust), newest first; `pending`: flight at the last
    passage, which waits for the next one to enter the bank."""

    flight: Flight
    episode: randomization.Episode
    error: jnp.ndarray
    voltage: jnp.ndarray
    gate: jnp.ndarray
    pilot_gate: jnp.ndarray
    p_seen: jnp.ndarray
    commands: jnp.ndarray
    previous_action: jnp.ndarray
    age: jnp.ndarray  # ticks since the start of the episode
    since_passage: jnp.ndarray  # ticks
    passages: jnp.ndarray
    pending: jnp.ndarray
    pending_gate: jnp.ndarray  # number of gates: none


class Outcome(NamedTuple):
    """What a step ended in, all (n,): reward, done (crashed, missed or stuck), timeout, passed, finer causes."""

    reward: jnp.ndarray
    done: jnp.ndarray
    timeout: jnp.ndarray
    passed: jnp.ndarray
    crashed: jnp.ndarray
    missed: jnp.ndarray
    margin: jnp.ndarray


def reset(world: World, bank, key, n: int, difficulty, podium_share) -> Agents:
    """Return `n` new episodes: on the podium with probability `podium_share`, else around a state of the bank."""
    keys = jax.random.split(key, 6)
    from_start = jax.random.uniform(keys[0], (n,)) < podium_share
    banked, gate_passed = starts.from_bank(world, bank, keys[1], n)
    flight = starts.choose(from_start, starts.podium(world, keys[2], n), banked)
    gate_count = world.gates.positions.shape[0]
    gate = jnp.where(from_start, 0, (gate_passed + 1) % gate_count)
    episode = randomization.draw_episode(keys[3], n, difficulty)
    charge = episode.charge_share * world.vehicle.battery.capacity
    flight = replace(flight, state=replace(flight.state, charge=charge))
    error = randomization.first_error(keys[4], episode)
    # On the podium the odometry has just been aligned with the map.
    error = jnp.where(from_start[:, None], 0.2 * error, error)
    rest = jnp.array([0.0, 0.0, 0.0, 0.0], jnp.float32)
    hover = jnp.array([0.0, 0.0, 0.0, GRAVITY], jnp.float32)
    command = jnp.where(from_start[:, None], rest, hover)
    idle_action = actions.from_command(command[:, 3], command[:, :3], world.max_thrust, world.max_rates)
    p_seen, _, _ = randomization.estimate(error, *pose_and_velocity(flight))
    zero = jnp.zeros((n,), jnp.int32)
    return Agents(
        flight=flight,
        episode=episode,
        error=error,
        voltage=jnp.full((n,), world.vehicle.battery.reference_voltage, jnp.float32),
        gate=gate,
        pilot_gate=gate,
        p_seen=p_seen,
        commands=jnp.repeat(command[:, None], 3, axis=1),
        previous_action=idle_action,
        age=zero,
        since_passage=zero,
        passages=zero,
        pending=starts.pack(flight),
        pending_gate=jnp.full((n,), gate_count, jnp.int32),
    )


def pose_and_velocity(flight: Flight):
    return flight.state.p_world, flight.state.q_world_body, flight.state.v_world


def observations(world: World, agents: Agents):
    """Return (what the pilot sees (n, 31), what the critic sees (n, 58)): the critic also gets the truth."""
    truth = pose_and_velocity(agents.flight)
    seen = randomization.estimate(agents.error, *truth)
    pilot = observe(seen[0], seen[2], seen[1], world.corners[agents.pilot_gate], agents.previous_action)
    true = observe(truth[0], truth[2], truth[1], world.corners[agents.gate], agents.previous_action)
    return pilot, jnp.concatenate([pilot, true[:, :27]], axis=-1)


def fly(world: World, agents: Agents, action, error_key) -> tuple[Agents, jnp.ndarray]:
    """Return (agents one tick on, rate command (n, 3) as sent): late command, simulator, estimate, pilot's gates."""
    thrust, omega = actions.to_command(action, world.max_thrust, world.max_rates)
    newest = jnp.concatenate([omega, thrust[:, None]], axis=-1)
    commands = jnp.concatenate([newest[:, None], agents.commands[:, :2]], axis=1)
    late = late_command(commands, agents.episode.delay_ticks)
    voltage = agents.voltage + agents.episode.voltage_error
    throttle = throttle_for_thrust(late[:, 3], voltage, world.vehicle, world.profile.motor_idle)
    armed = jnp.ones(throttle.shape, bool)
    parameters = randomization.parameters_of(agents.episode, world.parameters)
    frame = ReceiverFrame(late[:, :3], throttle, armed)
    flight, trace = advance(agents.flight, frame, FlightModel(parameters, world.profile))
    error = randomization.next_error(error_key, agents.error, agents.episode)
    p_seen, _, _ = randomization.estimate(error, *pose_and_velocity(flight))
    positions, rotations, side = world.gates.positions, world.gates.rotations, world.gates.outer_side
    pilot_gate, _ = gates.advance(agents.pilot_gate, positions, rotations, side, agents.p_seen, p_seen)
    moved = agents._replace(
        flight=flight,
        error=error,
        voltage=trace.voltage[-1],
        pilot_gate=pilot_gate,
        p_seen=p_seen,
        commands=commands,
        previous_action=action,
        age=agents.age + 1,
    )
    return moved, omega


def late_command(commands, delay_ticks):
    """Return the command (n, 4) in force: a delay of part of a tick mixes two of commands (n, 3, 4), newest first."""
    weights = jnp.maximum(1.0 - jnp.abs(jnp.arange(3) - delay_ticks[:, None]), 0.0)
    return jnp.sum(weights[..., None] * commands, axis=1)


def step(world: World, agents: Agents, action, key, scales: dict) -> tuple[Agents, Outcome]:
    """Return (agents one tick on, outcome). A finished episode is not reset here."""
    settings = world.settings
    moved, omega = fly(world, agents, action, key)
    p_before, p_after = agents.flight.state.p_world, moved.flight.state.p_world
    verdict = judging.judge(world.gates, agents.gate, p_before, moved.flight.state, settings.missed_window_m)
    touched = verdict.touched & (agents.age >= settings.grace_s / TICK)
    since_passage = jnp.where(verdict.passed, 0, agents.since_passage + 1)
    stuck = since_passage >= settings.stuck_s / TICK
    crashed = touched | verdict.outside
    timeout = moved.age >= settings.episode_s / TICK
    gate = jnp.where(verdict.passed, (agents.gate + 1) % world.gates.positions.shape[0], agents.gate)
    position, rotation = world.gates.positions[agents.gate], world.gates.rotations[agents.gate]
    width = settings.opening_half_width_m
    moment = rewards.Moment(
        distance_before=rewards.distance_to_opening(to_gate_frame(position, rotation, p_before), width),
        distance_after=rewards.distance_to_opening(to_gate_frame(position, rotation, p_after), width),
        gate_angle=gate_angle(world, moved.flight.state, gate),
        omega_command=omega,
        action=action,
        previous_action=agents.previous_action,
        crashed=crashed | verdict.missed | stuck,
        passed=verdict.passed,
        margin=verdict.margin,
    )
    moved = moved._replace(gate=gate, since_passage=since_passage, passages=agents.passages + verdict.passed)
    done = crashed | verdict.missed | stuck
    outcome = Outcome(
        rewards.total(moment, scales), done, timeout & ~done, verdict.passed, crashed, verdict.missed, verdict.margin
    )
    return moved, outcome


def gate_angle(world: World, state, gate):
    """Return the angle (n,) rad between the camera's optical axis and the centre of the next gate."""
    to_gate = geometry.normalize(world.gates.positions[gate] - state.p_world)
    axis = geometry.rotate(state.q_world_body, jnp.broadcast_to(world.camera_axis, to_gate.shape))
    return jnp.arccos(jnp.clip(jnp.sum(axis * to_gate, axis=-1), -0.999999, 0.999999))


def commit(agents: Agents, bank, gate_before, passed, key, straight: int):
    """Return (agents, bank): a state at a passage enters the bank once its flight passed the next gate as well."""
    bank = starts.remember(bank, agents.pending, agents.pending_gate, passed, key, straight)
    pending = jnp.where(passed[:, None], starts.pack(agents.flight), agents.pending)
    pending_gate = jnp.where(passed, gate_before, agents.pending_gate)
    return agents._replace(pending=pending, pending_gate=pending_gate), bank
