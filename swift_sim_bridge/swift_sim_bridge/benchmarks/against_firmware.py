"""Motor commands of the simulated firmware against those of the real one, on the same gyro and sticks.

Betaflight SITL built with gyro sync runs one pass of its loop for each gyro sample that it is sent; the simulated loop
runs as many. When a frame of sticks is taken is up to the real one's serial task: the pass is looked for in its motors,
for each frame among those until the next, beside one delay for all. Its feed-forward divides by the time from frame to
frame, and its smoothing follows it: that time it tells itself.
"""

from dataclasses import dataclass
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from swift_ros.text import align
from swift_sim_bridge.benchmarks.firmware_lives import SETTLED_FRAMES, Life
from swift_sim_bridge.benchmarks.firmware_sequences import INSTRUMENT, LACKING, MID_US, SET_UPS, Sequence, still
from swift_sim_bridge.flight_controller.configuration import cli_dump, rates
from swift_sim_bridge.flight_controller.configuration.controller_section import DumpedController
from swift_sim_bridge.flight_controller.configuration.dump_profile import profile_from_dump
from swift_sim_bridge.flight_controller.rate_loop.loop import LoopInput, initial_loop_state, rate_loop_step, take_frame
from swift_sim_bridge.flight_controller.rate_loop.stick_path import ReceiverFrame, Sticks
from swift_sim_bridge.flight_controller.sitl.replay import FRAME_PASSES
from swift_sim_bridge.flight_controller.sitl.sitl import LOOP_HZ

GYRO_COUNTS = 16.384  # a deg/s: what SITL's gyro resolves
MIN_CHECK_US = 1050
SURELY = 2.0  # times nearer, squared, by which another delay than the last frame's must be for a frame to have it
STICK_COLUMNS = (0, 1, 3)
LIMIT = 0.005


@dataclass(frozen=True)
class Difference:
    """RMS over passes and motors, as shares of the range: repeats: the real one from its mean, difference: of the
    simulated one from it, frames as they took effect; one_delay: the same with one delay for all frames."""

    set_up: str
    sequence: str
    repeats: float
    difference: float
    one_delay: float

    @property
    def excess(self) -> float:
        return self.difference - self.repeats


def controller_of(set_up: str) -> DumpedController:
    """Return the simulated controller with the same set-up."""
    dump = cli_dump.parse("\n".join([*INSTRUMENT, *SET_UPS[set_up], *LACKING]), set_up)
    return DumpedController(dump.settings, dump.features, dump.unmodelled, float(LOOP_HZ), 0.0, 4)


def simulated_motors(set_up: str, fed: dict[str, Sequence], life: Life, delay=None):
    """Return (motors (passes, 4) of each sequence, delay of each frame in passes), with frames taken when the real
    motors of `life` tell best, or after `delay` passes: of all, or of each frame."""
    controller = controller_of(set_up)
    profile = jax.tree.map(lambda leaf: jnp.asarray(leaf, jnp.float32), profile_from_dump(controller))
    commands = partial(_commands, rates.rate_profile(controller))
    rest = still(SETTLED_FRAMES)
    loop = initial_loop_state(jnp.zeros((FRAME_PASSES, 3), jnp.float32), profile)
    given = None if delay is None else iter(np.broadcast_to(delay, sum(len(one.frames_us) for one in fed.values())))
    intervals_s = iter(life.intervals_s.astype(np.float32))
    old, motors, delays, late = commands(rest.frames_us[0]), {}, [], 0
    for name, one in {"": rest, **fed}.items():
        rows = []
        for number, frame_us in enumerate(one.frames_us):
            part, new = slice(number * FRAME_PASSES, (number + 1) * FRAME_PASSES), commands(frame_us)
            gyro = _resolved(one.gyro_omega_body[part])
            loop, outputs = _frame(loop, old, new, gyro, profile, next(intervals_s))
            outputs = np.asarray(outputs)
            if name:
                late = _best(outputs, life.motors[name][part], late) if given is None else int(next(given))
                delays.append(late)
            loop = _after(loop, late)
            rows.append(outputs[:, late])
            old = new
        motors[name] = np.concatenate(rows)
    return {name: motors[name] for name in fed}, np.array(delays)


def _best(outputs, expected, usual: int) -> int:
    """Return the delay (an index) whose outputs (passes, delays, 4) come nearest; the usual one, where sticks that
    stand still tell as little of it as of another."""
    error = np.mean((outputs - expected[:, None]) ** 2, axis=(0, 2))
    return usual if error[usual] <= SURELY * error.min() + 1e-10 else int(np.argmin(error))


def _commands(curves, frame_us):
    """Return (setpoint (3,) rad/s, throttle, deflection (3,)) of a frame, as `FlightController` makes them."""
    sticks_us = [frame_us[place] for place in STICK_COLUMNS]
    bands_us = curves.deadband_us
    deflection = [rates.deflection_of(sticks_us[i], i, MID_US, bands_us[i]) for i in range(3)]
    setpoint = np.radians([rates.rate_deg_s(curves, axis, deflection[axis]) for axis in range(3)])
    throttle = rates.throttle_share(frame_us[2], MIN_CHECK_US, curves)
    return tuple(np.asarray(value, np.float32) for value in (setpoint, throttle, deflection))


def _resolved(gyro_omega_body):
    return np.radians(np.rint(np.degrees(gyro_omega_body) * GYRO_COUNTS) / GYRO_COUNTS).astype(np.float32)


@jax.jit
def _frame(loop, old, new, gyro, profile, interval_s):
    """Return (loop, motors (passes, delays, 4)) of one frame's passes, in row i taken after i passes."""
    delay, armed = jnp.arange(FRAME_PASSES), jnp.ones(FRAME_PASSES, bool)
    wide = lambda value: jnp.broadcast_to(value, (FRAME_PASSES, *value.shape))  # noqa: E731
    rows = [(wide(before), wide(after)) for before, after in zip(old, new, strict=True)]

    def one(loop, now):
        number, sample = now
        setpoint, throttle, deflection = (jnp.where(_like(number >= delay, b), b, a) for a, b in rows)
        sticks = Sticks(deflection, ~armed)
        taken = take_frame(loop, ReceiverFrame(setpoint, throttle, armed, sticks, interval_s), profile)
        loop = jax.tree.map(lambda a, b: jnp.where(_like(number == delay, a), a, b), taken, loop)
        return rate_loop_step(loop, LoopInput(setpoint, throttle, wide(sample)), profile, 1.0 / LOOP_HZ)

    return jax.lax.scan(one, loop, (jnp.arange(FRAME_PASSES), gyro))


@jax.jit
def _after(loop, delay):
    """Return the loop of row `delay` in every row. Compiled: leaf by leaf it took longer than the passes."""
    return jax.tree.map(lambda leaf: jnp.broadcast_to(leaf[delay], leaf.shape), loop)


def _like(chosen, values):
    return chosen.reshape(FRAME_PASSES, *[1] * (values.ndim - 1))


def compare(lives: list[Life], set_up: str, fed: dict[str, Sequence], tell) -> list[Difference]:
    """Return the differences of each sequence from `firmware_lives.lives`, the worst life counting."""
    found, alike = [], []
    for number, life in enumerate(lives, start=1):
        motors, delays = simulated_motors(set_up, fed, life)
        usual, _ = simulated_motors(set_up, fed, life, delay=int(np.median(delays)))
        found.append({name: _rms(motors[name] - life.motors[name]) for name in fed})
        alike.append({name: _rms(usual[name] - life.motors[name]) for name in fed})
        tell(f"{set_up}: compared {number} of {len(lives)} lives, worst {100 * max(found[-1].values()):.3f} % of range")
    rows = []
    for name in fed:
        mean = np.mean([life.motors[name] for life in lives], axis=0)
        spread = _rms(np.array([life.motors[name] - mean for life in lives]))
        worst = (max(each[name] for each in group) for group in (found, alike))
        rows.append(Difference(set_up, name, spread, *worst))
    return rows


def _rms(values) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def table(rows: list[Difference]) -> str:
    """Return the differences as text, percent of the motors' range, the worst named."""
    percent = lambda share: f"{100 * share:.3f}"  # noqa: E731
    head = ("set-up", "sequence", "run to run %", "difference %", "excess %", "one delay for all frames %")
    shares = ((row, (row.repeats, row.difference, row.excess, row.one_delay)) for row in rows)
    body = [(row.set_up, row.sequence, *map(percent, figures)) for row, figures in shares]
    worst, furthest = max(rows, key=lambda row: row.difference), max(rows, key=lambda row: row.excess)
    verdict = "all within" if furthest.excess <= LIMIT else f"beyond, in {furthest.set_up}, {furthest.sequence},"
    last = f"worst difference: {worst.set_up}, {worst.sequence}: {percent(worst.difference)} %"
    return f"{align([head, *body])}\n{last}; {verdict} {100 * LIMIT} % above run to run"
