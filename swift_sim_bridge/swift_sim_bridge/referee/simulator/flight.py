"""Flights of the referee's vehicle, several at once: RK4 with 1 ms steps, rate loop at 500 Hz, pilot at 100 Hz."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from swift_sim_bridge.referee.simulator import blind, disturbances, pilot
from swift_sim_bridge.referee.simulator.paths import TICK_S, Path
from swift_sim_bridge.referee.simulator.plant import GRAVITY, Inputs, Outputs, State, derivative, plant_of
from swift_sim_bridge.referee.simulator.polynomial import summands_of
from swift_sim_bridge.referee.simulator.vectors import parts

LOOP_HZ, STEP_S = 500, 0.001  # rate of the rate loop; physics step, s
LOOP_S = 1.0 / LOOP_HZ
PASSES = round(TICK_S / LOOP_S)
STEPS = round(LOOP_S / STEP_S)
COMMAND_ERRORS = {  # terms that distort commands, with the values that do nothing
    "rate_scale": {"scale": [1.0] * 3, "offset": [0.0] * 3, "cubic": [0.0] * 3},
    "throttle_curve": {"gain": 0.0, "curve": 0.0},
}
GYRO_ERRORS = {"gyro_bias": {"bias": [0.0] * 3}, "gyro_scale": {"scale": [0.0] * 3}}
HISTORY = disturbances.MAX_AGE + 1  # commands that are kept


@dataclass(frozen=True)
class Order:
    """A flight to simulate.

    Attributes:
        content: content of the true vehicle file.
        nominal: content of the vehicle file that its rate loop and pilot use.
        path: path to fly.
        seed: seed of all random numbers.
        gyro_noise: standard deviation of a gyro sample, rad/s.
        roughness: scale of the process noise (see `disturbances`).
    """

    content: dict
    nominal: dict
    path: Path
    seed: int
    gyro_noise: float = 0.0
    roughness: float = 0.0


@dataclass(frozen=True)
class Truth:
    """The true course of a flight, at each of n passes of the rate loop.

    Attributes:
        t: times (n,), s.
        p, q, v, w, rotor_speed, charge, rc: as in `State`, (n, 3), (n, 4) or (n,).
        memory: the same, (n, 3), or (n, 0) without the laws in `blind`.
        specific_force, angular_acceleration, voltage, current: as in `Outputs`, (n, 3) or (n,).
        u: motor commands (n, rotors) from t on.
        gyro: gyro (n, 3) as the rate loop read it, rad/s.
        t_command: times (m,) of the pilot's commands, s.
        rates: commanded rates (m, 3), rad/s.
        thrust: commanded collective thrust (m,), m/s^2.
    """

    t: np.ndarray
    p: np.ndarray
    q: np.ndarray
    v: np.ndarray
    w: np.ndarray
    rotor_speed: np.ndarray
    charge: np.ndarray
    rc: np.ndarray
    memory: np.ndarray
    specific_force: np.ndarray
    angular_acceleration: np.ndarray
    voltage: np.ndarray
    current: np.ndarray
    u: np.ndarray
    gyro: np.ndarray
    t_command: np.ndarray
    rates: np.ndarray
    thrust: np.ndarray


def fly(orders: Sequence[Order]) -> list[Truth]:
    """Simulate several orders at once; their paths must have the same length."""
    with jax.enable_x64(True):
        contents = [order.content for order in orders]
        inputs = [_inputs(order, contents) for order in orders]
        inputs = jax.tree.map(lambda *rows: jnp.stack([jnp.asarray(row, float) for row in rows], axis=-1), *inputs)
        seen, commands = jax.tree.map(np.asarray, _flown(*inputs))
    return [_truth(i, seen, commands) for i in range(len(orders))]


def _inputs(order: Order, contents: Sequence[dict]):
    """Return the parameters, the initial state and the inputs of each tick of one order, to be flown among contents."""
    terms = order.content.get("terms", {})
    ticks, rotors = len(order.path.p), len(order.content["rotors"])
    rng = np.random.default_rng([order.seed, 7])
    vehicle = vehicle_of(order.content, order.nominal, contents)
    start = at_rest(order.content, order.path.p[0], order.path.yaw[0], contents)
    shape = (ticks, PASSES)
    each = {
        "aim": pilot.Aim(**{name: getattr(order.path, name) for name in pilot.Aim._fields}),
        "noise": order.gyro_noise * rng.standard_normal((*shape, 3)),
        "age": disturbances.command_ages(terms, ticks, PASSES, LOOP_S, rng),
        "gust": disturbances.gust(terms.get("gust"), ticks * PASSES, LOOP_S, rng).reshape(*shape, 3),
        "push": disturbances.process_noise(order.roughness * disturbances.FORCE_NOISE, shape, LOOP_S, rng),
        "twist": disturbances.process_noise(order.roughness * disturbances.MOMENT_NOISE, shape, LOOP_S, rng),
        "ring": disturbances.buffet(terms.get("vortex_ring"), (*shape, rotors), LOOP_S, rng),
    }
    return vehicle, start, each


def vehicle_of(content: dict, nominal: dict, among: Sequence[dict]) -> dict:
    """Return the parameters of a vehicle with its rate loop and pilot.

    Args:
        content: content of the true vehicle file.
        nominal: content of the vehicle file that rate loop and pilot use.
        among: contents of all vehicles of the same call, whose equations it takes with coefficients of zero.
    """
    terms = content.get("terms", {})
    return {
        "plant": plant_of(content, summands_of(among), among),
        "controls": pilot.controls_of(nominal),
        "bend": {name: idle | terms.get(name, {}) for name, idle in COMMAND_ERRORS.items()},
        "gyro": {name: (idle | terms.get(name, {}))[name.split("_")[1]] for name, idle in GYRO_ERRORS.items()},
    }


def at_rest(content: dict, p, yaw: float, among: Sequence[dict]) -> State:
    """Return the state of a level vehicle at p (3,) m with heading `yaw` rad and rotors that carry its weight."""
    rotors = len(content["rotors"])
    hover = np.sqrt(content["mass"] * GRAVITY / (rotors * content["thrust_coefficient"]))
    return State(
        p=np.asarray(p, dtype=float),
        q=np.array([0.0, 0.0, np.sin(0.5 * yaw), np.cos(0.5 * yaw)]),
        v=np.zeros(3),
        w=np.zeros(3),
        rotor_speed=np.full(rotors, hover),
        charge=0.0,
        rc=0.0,
        memory=np.array(blind.REST) if blind.any_in(among) else (),
    )


@jax.jit
def _flown(vehicle, start: State, each):
    """Return state, outputs, motor commands and gyro of each pass (ticks, passes, ...), and the pilot's commands."""
    start = in_parts(start)
    loop = first_loop(start)
    first = jnp.stack([*loop.integral, 0.0 * start.charge + GRAVITY])

    def tick(carry, now):
        state, loop, sent = carry
        aim = pilot.Aim(*(parts(row) if jnp.ndim(row) > 1 else row for row in now["aim"]))
        rates, thrust = pilot.command(state, aim, vehicle["controls"])
        sent = jnp.concatenate([jnp.stack([*rates, thrust])[None], sent[:-1]])
        given = {name: now[name] for name in now if name != "aim"}
        (state, loop), seen = fly_tick(state, loop, vehicle, sent, given)
        return (state, loop, sent), (seen, sent[0])

    return jax.lax.scan(tick, (start, loop, jnp.stack([first] * HISTORY)), each)[1]


def in_parts(state: State) -> State:
    """Return a state of arrays with its vectors as tuples of their parts."""
    return State(*(parts(row) if np.ndim(row) > 1 else row for row in state))


def first_loop(start: State) -> pilot.Loop:
    """Return the memory of rate loops that have not run yet."""
    nothing = tuple(0.0 * row for row in start.w)
    return pilot.Loop(nothing, nothing, nothing)


def fly_tick(state: State, loop: pilot.Loop, vehicle: dict, sent, given: dict):
    """Fly one tick of the pilot: all passes of the rate loop; return (state, loop), and what each pass saw.

    Args:
        state: of b vehicles.
        loop: memory of their rate loops.
        vehicle: parameters, see `vehicle_of`, with a last axis of b.
        sent: the last commands (HISTORY, 4, b), newest first: rates (rad/s) and thrust (m/s^2).
        given: `noise`, `age`, `gust`, `push`, `twist` and `ring` of each pass, with a last axis of b.
    """
    return jax.lax.scan(partial(_pass, vehicle=vehicle, sent=sent), (state, loop), given)


def _pass(carry, now, vehicle, sent):
    """Run one pass of the rate loop and the physics until the next; return state and memory, and the first values."""
    state, loop = carry
    chosen = (jnp.arange(HISTORY)[:, None] == now["age"][None]).astype(sent.dtype)
    *rates, thrust = parts(jnp.sum(sent * chosen[:, None], axis=0))
    rates, thrust = pilot.distorted_command(tuple(rates), thrust, vehicle["controls"], vehicle["bend"])
    errors, noise = vehicle["gyro"], parts(now["noise"])
    gyro = tuple((1.0 + errors["gyro_scale"][i]) * state.w[i] + errors["gyro_bias"][i] + noise[i] for i in range(3))
    loop, u = pilot.motor_commands(loop, gyro, rates, thrust, vehicle["controls"], LOOP_S)
    inputs = Inputs(u, parts(now["gust"]), parts(now["push"]), parts(now["twist"]), parts(now["ring"]))
    outputs = derivative(state, inputs, vehicle["plant"])[1]
    seen = (_stacked(state), _stacked(outputs), jnp.stack(u), jnp.stack(gyro))
    state = jax.lax.fori_loop(0, STEPS, lambda _, at: rk4(at, inputs, vehicle["plant"], STEP_S), state)
    return (state, loop), seen


def rk4(state: State, inputs: Inputs, plant: dict, dt: float) -> State:
    """Return the state `dt` s later by the classical Runge-Kutta method, with a unit quaternion."""

    def stage(carry, step):
        slope, total = carry
        ahead, weight = step
        slope = derivative(advanced(state, slope, ahead * dt), inputs, plant)[0]
        return (slope, advanced(total, slope, weight * dt)), None

    still = jax.tree.map(jnp.zeros_like, state)
    steps = jnp.array([[0.0, 1 / 6], [0.5, 1 / 3], [0.5, 1 / 3], [1.0, 1 / 6]])
    state = jax.lax.scan(stage, (still, state), steps)[0][
        1
    ]  # as a loop: four inlined stages would take long to compile
    length = jnp.sqrt(sum(part**2 for part in state.q))
    state = state._replace(q=tuple(part / length for part in state.q))
    return state._replace(memory=blind.limited(state.memory, plant)) if plant["blind"] else state


def advanced(state: State, slope: State, time) -> State:
    """Return the state after `time` s with a constant derivative."""
    return jax.tree.map(lambda value, rate: value + time * rate, state, slope)


def _stacked(record):
    """Return a record with its vectors as arrays, but for an empty one."""
    return type(record)(*(jnp.stack(part) if isinstance(part, tuple) and part else part for part in record))


def _truth(i: int, seen, commands) -> Truth:
    """Return flight i of the results of `_flown`."""
    state, outputs, u, gyro = seen
    state, outputs = State(*state), Outputs(*outputs)

    def rows(values):
        values = values[..., i]
        return values.reshape(-1, *values.shape[2:])

    ticks = len(commands)
    return Truth(
        t=np.arange(ticks * PASSES) / LOOP_HZ,
        p=rows(state.p),
        q=rows(state.q),
        v=rows(state.v),
        w=rows(state.w),
        rotor_speed=rows(state.rotor_speed),
        charge=rows(state.charge),
        rc=rows(state.rc),
        memory=rows(state.memory) if len(state.memory) else np.zeros((ticks * PASSES, 0)),
        specific_force=rows(outputs.specific_force),
        angular_acceleration=rows(outputs.angular_acceleration),
        voltage=rows(outputs.voltage),
        current=rows(outputs.current),
        u=rows(u),
        gyro=rows(gyro),
        t_command=np.arange(0, ticks * PASSES, PASSES) / LOOP_HZ,
        rates=commands[:, :3, i],
        thrust=commands[:, 3, i],
    )
