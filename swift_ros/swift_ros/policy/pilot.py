"""The pilot: from a state to a command, with its own idea of the next gate. Pure; the node is a shell around it."""

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

REST = np.array([-1.0, 0.0, 0.0, 0.0], dtype=np.float32)  # the action that commands nothing: no thrust, no rates
UNIT_TOLERANCE = 1e-3


@dataclass(frozen=True)
class PilotStep:
    """What the pilot made of one state. observation (31,), action (4,) clipped, both as fed and answered; next_gate:
    index flown at; lap: laps completed by the pilot's own count; command: what to do."""

    observation: np.ndarray
    action: np.ndarray
    next_gate: int
    lap: int
    command: BodyRateThrust


class Pilot:
    """Flies a track. It rests, commanding nothing, while there is no race; it counts gates on its own estimate."""

    def __init__(self, actor: Actor, track: Track, vehicle: Vehicle):
        self._actor = actor
        self._track = track
        self._max_thrust = vehicle.max_thrust / vehicle.mass
        self._max_rates = np.array(vehicle.rates.max)
        self.reset()

    def reset(self) -> None:
        """Forget everything: at rest on the podium, and no race announced."""
        self._race = ScheduledState()
        self._rest()

    def announce(self, stamp_ns: int, state: str) -> None:
        """Take the word (of race/status) on the state of the race from `stamp_ns` on. A start is announced ahead of its
        time, so that it never depends on when the word arrives."""
        self._race.schedule(stamp_ns, state)

    def _rest(self) -> None:
        self._passed = 0
        self._previous_action = REST
        self._p_before: np.ndarray | None = None

    @property
    def next_gate(self) -> int:
        return self._passed % len(self._track.gates)

    @property
    def lap(self) -> int:
        return max(0, (self._passed - 1) // len(self._track.gates))

    def update(self, state: Odometry) -> PilotStep:
        """Return the step at a state of the map frame.

        Raises ValueError for a state that is not finite or whose quaternion is not of length one, and for a network
        that answers with a number that is not finite.
        """
        check(state)
        # After the finish the pilot flies on until `betaflight` has braked and put the vehicle down.
        racing = self._race.at(state.stamp_ns) in (RACING, FINISHED)
        if racing:
            self._count_gates(state.p_world)
        else:
            self._rest()
        v_map = geometry.rotate(state.q_world_body, state.v_body)
        corners = self._track.corners[self.next_gate]
        observation = observe(state.p_world, v_map, state.q_world_body, corners, self._previous_action)
        observation = observation.astype(np.float32)
        action = actions.clip(self._actor.act(observation)) if racing else REST
        if not np.all(np.isfinite(action)):
            raise ValueError("the pilot's network answered with a number that is not finite")
        self._previous_action = action
        thrust, omega_body = actions.to_command(action.astype(float), self._max_thrust, self._max_rates)
        command = BodyRateThrust(state.stamp_ns, float(thrust), omega_body)
        return PilotStep(observation, action, self.next_gate, self.lap, command)

    def _count_gates(self, p_map) -> None:
        track = self._track
        if self._p_before is not None:
            frame = track.positions[self.next_gate], track.rotations[self.next_gate]
            self._passed += int(gates.passed(*frame, track.outer_side, self._p_before, p_map))
        self._p_before = p_map


def check(state: Odometry) -> None:
    """Raise ValueError, saying what is wrong, for a state that nobody should fly by."""
    for name in ("p_world", "q_world_body", "v_body"):
        if not np.all(np.isfinite(getattr(state, name))):
            raise ValueError(f"the state at {1e-9 * state.stamp_ns:.3f} s has a {name} that is not finite")
    if abs(float(np.linalg.norm(state.q_world_body)) - 1.0) > UNIT_TOLERANCE:
        raise ValueError(f"the state at {1e-9 * state.stamp_ns:.3f} s has a quaternion that is not of length one")
