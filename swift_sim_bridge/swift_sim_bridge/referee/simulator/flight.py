"""Whole flights of the referee's vehicle, several at once: RK4 at 1 ms, rate loop at 500 Hz, pilot at 100 Hz."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from swift_sim_bridge.referee.simulator import disturbances, pilot
from swift_sim_bridge.referee.simulator.paths import TICK_S, Path
from swift_sim_bridge.referee.simulator.plant import GRAVITY, Felt, Held, State, derivative, parts, plant_of

LOOP_HZ, STEP_S = 500, 0.001
LOOP_S = 1.0 / LOOP_HZ
PASSES = round(TICK_S / LOOP_S)
STEPS = round(LOOP_S / STEP_S)
BEND = {
    "rate_scale": {"scale": [1.0] * 3, "offset": [0.0] * 3, "cubic": [0.0] * 3},
    "throttle_curve": {"gain": 0.0, "curve": 0.0},
}
GYRO = {"gyro_bias": {"bias": [0.0] * 3}, "gyro_scale": {"scale": [0.0] * 3}}
HISTORY = disturbances.LONGEST_AGE + 1


@dataclass(frozen=True)
class Order:
    """A flight to make. content: the true vehicle, as a vehicle file's content; nominal: the one that its firmware and
    pilot know; path; seed: of what is random in it; gyro_noise rad/s; roughness: of the process noise, 0 to 1."""

    content: dict
    nominal: dict
    path: Path
    seed: int
    gyro_noise: float = 0.0
    roughness: float = 0.0


@dataclass(frozen=True)
class Truth:
    """What happened, at each pass of the rate loop: t (n,) s and, as `State` and `Felt` say, (n, 3), (n, 4) or (n,);
    u (n, rotors) set at t; gyro (n, 3) as the loop read it. rates (m, 3) and thrust (m,): commanded at t_command."""

    t: np.ndarray
    p: np.ndarray
    q: np.ndarray
    v: np.ndarray
    w: np.ndarray
    spin: np.ndarray
    charge: np.ndarray
    rc: np.ndarray
    force: np.ndarray
    turning: np.ndarray
    voltage: np.ndarray
    current: np.ndarray
    u: np.ndarray
    gyro: np.ndarray
    t_command: np.ndarray
    rates: np.ndarray
    thrust: np.ndarray


def fly(orders: Sequence[Order]) -> list[Truth]:
    """Return the flights of several orders, whose paths are of one length, at once."""
    with jax.enable_x64(True):
        inputs = [_inputs(order) for order in orders]
        inputs = jax.tree.map(lambda *rows: jnp.stack([jnp.asarray(row, float) for row in rows], axis=-1), *inputs)
        seen, commands = jax.tree.map(np.asarray, _flown(*inputs))
    return [_truth(i, seen, commands) for i in range(len(orders))]


def _inputs(order: Order):
    """Return (vehicle, start, what comes each tick) of one order."""
    terms = order.content.get("terms", {})
    ticks = len(order.path.p)
    rng = np.random.default_rng([order.seed, 7])
    vehicle = {
        "plant": plant_of(order.content),
        "controls": pilot.controls_of(order.nominal),
        "bend": {name: idle | terms.get(name, {}) for name, idle in BEND.items()},
        "gyro": {name: (idle | terms.get(name, {}))[name.split("_")[1]] for name, idle in GYRO.items()},
    }
    rotors = len(order.content["rotors"])
    hover = np.sqrt(order.content["mass"] * GRAVITY / (rotors * order.content["thrust_coefficient"]))
    zeros, yaw = np.zeros(3), 0.5 * order.path.yaw[0]
    start = State(
        order.path.p[0], np.array([0.0, 0.0, np.sin(yaw), np.cos(yaw)]), zeros, zeros, np.full(rotors, hover), 0.0, 0.0
    )
    shape = (ticks, PASSES)
    each = {
        "aim": pilot.Aim(**{name: getattr(order.path, name) for name in pilot.Aim._fields}),
        "noise": order.gyro_noise * rng.standard_normal((*shape, 3)),
        "age": disturbances.ages(terms, ticks, PASSES, LOOP_S, rng),
        "gust": disturbances.gust(terms.get("gust"), ticks * PASSES, LOOP_S, rng).reshape(*shape, 3),
        "push": disturbances.process(order.roughness * disturbances.PUSH, shape, LOOP_S, rng),
        "twist": disturbances.process(order.roughness * disturbances.TWIST, shape, LOOP_S, rng),
        "ring": disturbances.buffet(terms.get("vortex_ring"), (*shape, rotors), LOOP_S, rng),
    }
    return vehicle, start, each


@jax.jit
def _flown(vehicle, start: State, each):
    """Return what is seen at each pass (ticks, passes, ...) and the commands of each tick."""
    start = State(*(parts(row) if np.ndim(row) > 1 else row for row in start))
    nothing = tuple(0.0 * row for row in start.w)
    first = jnp.stack([*nothing, 0.0 * start.charge + GRAVITY])
    loop = pilot.Loop(nothing, nothing, nothing)

    def tick(carry, now):
        state, loop, sent = carry
        aim = pilot.Aim(*(parts(row) if jnp.ndim(row) > 1 else row for row in now["aim"]))
        rates, thrust = pilot.command(state, aim, vehicle["controls"])
        sent = jnp.concatenate([jnp.stack([*rates, thrust])[None], sent[:-1]])
        given = {name: now[name] for name in now if name != "aim"}
        (state, loop), seen = jax.lax.scan(partial(_pass, vehicle=vehicle, sent=sent), (state, loop), given)
        return (state, loop, sent), (seen, sent[0])

    return jax.lax.scan(tick, (start, loop, jnp.stack([first] * HISTORY)), each)[1]


def _pass(carry, now, vehicle, sent):
    """Return state and memory after one pass of the rate loop and the physics until the next, and what is seen."""
    state, loop = carry
    chosen = (jnp.arange(HISTORY)[:, None] == now["age"][None]).astype(sent.dtype)
    *rates, thrust = parts(jnp.sum(sent * chosen[:, None], axis=0))
    rates, thrust = pilot.bent(tuple(rates), thrust, vehicle["controls"], vehicle["bend"])
    own, noise = vehicle["gyro"], parts(now["noise"])
    gyro = tuple((1.0 + own["gyro_scale"][i]) * state.w[i] + own["gyro_bias"][i] + noise[i] for i in range(3))
    loop, u = pilot.motor_commands(loop, gyro, rates, thrust, vehicle["controls"], LOOP_S)
    held = Held(u, parts(now["gust"]), parts(now["push"]), parts(now["twist"]), parts(now["ring"]))
    felt = derivative(state, held, vehicle["plant"])[1]
    seen = (_stacked(state), _stacked(felt), jnp.stack(u), jnp.stack(gyro))
    state = jax.lax.fori_loop(0, STEPS, lambda _, at: rk4(at, held, vehicle["plant"], STEP_S), state)
    return (state, loop), seen


def rk4(state: State, held: Held, plant: dict, dt: float) -> State:
    """Return the state `dt` s later by the classical Runge-Kutta method, the quaternion at length one."""

    def stage(carry, step):
        slope, total = carry
        ahead, weight = step
        slope = derivative(moved(state, slope, ahead * dt), held, plant)[0]
        return (slope, moved(total, slope, weight * dt)), None

    still = jax.tree.map(jnp.zeros_like, state)
    steps = jnp.array([[0.0, 1 / 6], [0.5, 1 / 3], [0.5, 1 / 3], [1.0, 1 / 6]])
    state = jax.lax.scan(stage, (still, state), steps)[0][1]  # a loop: four copies would take long to compile
    length = jnp.sqrt(sum(part**2 for part in state.q))
    return state._replace(q=tuple(part / length for part in state.q))


def moved(state: State, slope: State, time) -> State:
    """Return the state after `time` s at a constant slope."""
    return jax.tree.map(lambda value, rate: value + time * rate, state, slope)


def _stacked(record):
    return type(record)(*(jnp.stack(part) if isinstance(part, tuple) else part for part in record))


def _truth(i: int, seen, commands) -> Truth:
    state, felt, u, gyro = seen
    state, felt = State(*state), Felt(*felt)

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
        spin=rows(state.spin),
        charge=rows(state.charge),
        rc=rows(state.rc),
        force=rows(felt.force),
        turning=rows(felt.turning),
        voltage=rows(felt.voltage),
        current=rows(felt.current),
        u=rows(u),
        gyro=rows(gyro),
        t_command=np.arange(0, ticks * PASSES, PASSES) / LOOP_HZ,
        rates=commands[:, :3, i],
        thrust=commands[:, 3, i],
    )
