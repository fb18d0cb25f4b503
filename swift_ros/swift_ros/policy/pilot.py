"""The pilot in a race: computes a command for each state and counts gates by its own estimate. No ROS."""

from dataclasses import dataclass

import numpy as np

from swift_ros import geometry
from swift_ros.policy import action as actions
from swift_ros.policy import gates
from swift_ros.policy.actor import Actor
from swift_ros.policy.observation import observe
from swift_ros.race.judge import FINISHED, RACING, ScheduledState
from swift_ros.track import Track
from swift_ros.types import BodyRateThrust, Odometry
from swift_ros.vehicle import Vehicle

IDLE_ACTION = np.array([-1.0, 0.0, 0.0, 0.0], dtype=np.float32)  # no thrust, no body rates
UNIT_LENGTH_TOLERANCE = 1e-3  # a quaternion whose length differs more from 1 is refused


@dataclass(frozen=True)
class PilotStep:
    """Result of the pilot for one state.

    Attributes:
        observation: input of the network (31,).
        action: its clipped output (4,).
        next_gate: index of the next gate.
        lap: number of completed laps by the pilot's own count.
        command: the command.
    """

    observation: np.ndarray
    action: np.ndarray
    next_gate: int
    lap: int
    command: BodyRateThrust


class Pilot:
    """Pilot of one vehicle on one track. Without a race it commands no thrust.

    Args:
        actor: the network.
        track: the track.
        vehicle: for the largest thrust and body rates.
    """

    def __init__(self, actor: Actor, track: Track, vehicle: Vehicle):
        self._actor = actor
        self._track = track
        self._max_thrust = vehicle.max_thrust / vehicle.mass
        self._max_rates = np.array(vehicle.rates.max)
        self.reset()

    def reset(self) -> None:
        """Return to the initial state: idle, without an announced race."""
        self._race = ScheduledState()
        self._idle()

    def announce(self, stamp_ns: int, state: str) -> None:
        """Announce the state of the race (of race/status) from `stamp_ns` on.

        A start is announced in advance, so that it does not depend on the time of reception.
        """
        self._race.schedule(stamp_ns, state)

    def _idle(self) -> None:
        self._passed = 0
        self._previous_action = IDLE_ACTION
        self._p_before: np.ndarray | None = None

    @property
    def next_gate(self) -> int:
        """Index of the next gate."""
        return self._passed % len(self._track.gates)

    @property
    def lap(self) -> int:
        """Number of completed laps."""
        return max(0, (self._passed - 1) // len(self._track.gates))

    def update(self, state: Odometry) -> PilotStep:
        """Return the result for a state in the map frame.

        Raises:
            ValueError: the state or the output of the network is not finite, or the quaternion's length is not one.
        """
        check(state)
        # After the finish the pilot continues until the node betaflight takes over and lands.
        racing = self._race.at(state.stamp_ns) in (RACING, FINISHED)
        if racing:
            self._count_gates(state.p_world)
        else:
            self._idle()
        v_map = geometry.rotate(state.q_world_body, state.v_body)
        corners = self._track.corners[self.next_gate]
        observation = observe(state.p_world, v_map, state.q_world_body, corners, self._previous_action)
        observation = observation.astype(np.float32)
        action = actions.clip(self._actor.act(observation)) if racing else IDLE_ACTION
        if not np.all(np.isfinite(action)):
            raise ValueError("the output of the pilot's network is not finite")
        self._previous_action = action
        thrust, omega_body = actions.to_command(action.astype(float), self._max_thrust, self._max_rates)
        command = BodyRateThrust(state.stamp_ns, float(thrust), omega_body)
        return PilotStep(observation, action, self.next_gate, self.lap, command)

    def _count_gates(self, p_map) -> None:
        track = self._track
        if self._p_before is not None:
            frame = track.positions[self.next_gate], track.rotations[self.next_gate]
            self._passed += int(gates.passed(*frame, track.outer_sides[self.next_gate], self._p_before, p_map))
        self._p_before = p_map


def check(state: Odometry) -> None:
    """Raise ValueError for a state that is not finite or whose quaternion has not length one."""
    for name in ("p_world", "q_world_body", "v_body"):
        if not np.all(np.isfinite(getattr(state, name))):
            raise ValueError(f"the state at {1e-9 * state.stamp_ns:.3f} s has a {name} that is not finite")
    if abs(float(np.linalg.norm(state.q_world_body)) - 1.0) > UNIT_LENGTH_TOLERANCE:
        raise ValueError(f"the state at {1e-9 * state.stamp_ns:.3f} s has a quaternion whose length is not one")
