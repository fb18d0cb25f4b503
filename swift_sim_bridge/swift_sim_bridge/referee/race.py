"""Races of the referee's vehicles through the shipped track, flown by a pilot of this repository.

The pilot is the code that flies, with the true state of the referee's simulator; rate loop, motors, battery and air are
the referee's. So a race takes as long as the physics lets it, other than the flights along a path. Frames and ground
are not solid: a race is finished when the pilot has counted all passages, and ends outside of the flight volume. What
is compared between worlds is how long a race takes, not whether the hull would have touched something.
"""

from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np

from swift_ros import configuration, geometry
from swift_ros.policy.actor import Actor
from swift_ros.policy.pilot import Pilot
from swift_ros.race.judge import RACING
from swift_ros.track import Track
from swift_ros.types import Odometry
from swift_ros.vehicle import Vehicle
from swift_sim_bridge.referee.simulator.flight import (
    HISTORY,
    PASSES,
    at_rest,
    first_loop,
    fly_tick,
    in_parts,
    vehicle_of,
)
from swift_sim_bridge.referee.simulator.paths import TICK_S
from swift_sim_bridge.referee.simulator.plant import State
from swift_sim_bridge.referee.simulator.vehicles import plain

PILOT = "pilots/split_s_careful.onnx"  # the shipped pilot with most reserve for physics it was not trained in
MOST_TICKS = 3500  # 35 s; races of this pilot take 20 to 25 s
# Gains of a rate loop that follows this pilot, times the motors' lag; the gains of other families are too low for it.
RATE_KP, RATE_KD = 1.4, 0.5


def raceable(content: dict) -> dict:
    """Return the content of a vehicle that the pilot can race: its thrust, lag and drag by mass, and a fast rate loop.

    Geometry, inertia, motors, battery and mass stay as they were drawn.
    """
    shipped, rotors, top = _shipped("drone.yaml", Vehicle), len(content["rotors"]), content["rotor_speed_range"][1]
    share, lag = content["mass"] / shipped.mass, shipped.motor.time_constant_up
    rate_kp, rotor_drag, body_drag = RATE_KP / lag, shipped.terms["rotor_drag"]["k_d"], shipped.terms["body_drag"]["c"]
    changed = {
        "thrust_coefficient": share * shipped.max_thrust / (rotors * _full_speed(content) ** 2),
        "motor": {"time_constant_up": lag, "time_constant_down": lag},
        "terms": {
            "rotor_drag": {"k_d": share * rotor_drag * shipped.rotor_speed_range[1] / top},
            "body_drag": {"c": [share * c for c in body_drag]},
        },
        "controller": {"rate_kp": [rate_kp, rate_kp, 0.5 * rate_kp], "rate_kd": [RATE_KD, RATE_KD, 0.0]},
    }
    changed |= {name: content[name] | changed[name] for name in ("motor", "terms", "controller")}
    return plain(content | changed)


def _full_speed(content: dict) -> float:
    """Return the rotors' speed under full command at the reference voltage, rad/s."""
    c, voltage = content["motor"]["map"]["coefficients"], content["battery"]["reference_voltage"]
    return c[0] + c[1] * voltage + c[2] + c[3] + c[4] * voltage


def race_times(contents: Sequence[dict], nominal: dict) -> list[float | None]:
    """Return the time of a race in each of several worlds, s, without noise; None where it is not finished.

    Args:
        contents: contents of vehicle files, one for each world.
        nominal: content of the vehicle file that the rate loop uses.
    """
    track, vehicle = _shipped("track.yaml", Track), _shipped("drone.yaml", Vehicle)
    actor = Actor(configuration.shipped_folder() / PILOT)
    racing = {i: Pilot(actor, track, vehicle) for i in range(len(contents))}
    for pilot in racing.values():
        pilot.announce(0, RACING)
    times: list[float | None] = [None] * len(contents)
    sent, still = np.zeros((4, len(contents))), _still(len(contents), len(nominal["rotors"]))
    with jax.enable_x64(True):
        state, flown = _on_the_podium(contents, nominal, track)
        loop, motion = first_loop(state), _motion(state)
        for tick in range(MOST_TICKS):
            for i, pilot in tuple(racing.items()):
                odometry = _odometry(np.asarray(motion)[:, i], tick)
                if not np.all((odometry.p_world > track.bounds_min) & (odometry.p_world < track.bounds_max)):
                    del racing[i]  # outside, or no longer finite
                    continue
                command = pilot.update(odometry).command
                sent[:, i] = *command.omega_body, command.thrust
                if pilot.lap >= track.laps:
                    times[i] = tick * TICK_S
                    del racing[i]
            if not racing:
                break
            state, loop, motion = _fly_tick(state, loop, flown, np.stack([sent] * HISTORY), still)
    return times


def _on_the_podium(contents: Sequence[dict], nominal: dict, track: Track) -> tuple[State, dict]:
    """Return the states of b vehicles at the start of the track, and their parameters."""
    yaw = np.radians(track.start_yaw_deg)
    built = [(at_rest(one, track.start, yaw, contents), vehicle_of(one, nominal, contents)) for one in contents]
    start, flown = jax.tree.map(lambda *rows: jnp.stack([jnp.asarray(row, float) for row in rows], axis=-1), *built)
    return in_parts(start), flown


@jax.jit
def _fly_tick(state: State, loop, vehicle: dict, sent, given: dict):
    """Return state, rate loops and motion of b vehicles after a tick, see `flight.fly_tick`."""
    (state, loop), _ = fly_tick(state, loop, vehicle, sent, given)
    return state, loop, _motion(state)


def _motion(state: State):
    """Return position, attitude, velocity and body rates (13, b) of b vehicles."""
    return jnp.stack([*state.p, *state.q, *state.v, *state.w])


def _odometry(motion, tick: int) -> Odometry:
    """Return the motion (13,) of a vehicle as the pilot reads it."""
    p, q, v, w = np.split(motion, (3, 7, 10))
    return Odometry(round(1e9 * tick * TICK_S), p, q, geometry.rotate_inverse(q, v), w)


def _still(count: int, rotors: int) -> dict:
    """Return the inputs of each pass without noise, gusts and delays."""
    nothing = np.zeros((PASSES, 3, count))
    given = dict.fromkeys(("noise", "gust", "push", "twist"), nothing)
    return given | {"age": np.zeros((PASSES, count), int), "ring": np.zeros((PASSES, rotors, count))}


def _shipped(name: str, kind):
    """Return a file of the shipped configuration."""
    return configuration.load(kind, configuration.shipped_folder() / name)
