"""Motor commands of the simulated firmware compared with those of the real one, for the same gyro and sticks.

Betaflight SITL built with gyro sync runs one pass of its loop for each gyro sample that it receives; the simulated loop
runs as many. The real firmware takes a frame of sticks when its serial task runs: that pass is estimated from its
motors, for each frame among the passes until the next frame. The comparison with one delay for all frames is reported
beside it. The feed-forward divides by the time from frame to frame, which also sets the smoothing; the firmware reports
that time itself.
"""

from dataclasses import dataclass
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from swift_ros.text import align
from swift_sim_bridge.benchmarks.firmware_runs import SETTLED_FRAMES, FirmwareRun
from swift_sim_bridge.benchmarks.firmware_sequences import INSTRUMENT, LACKING, MID_US, SET_UPS, Sequence, still
from swift_sim_bridge.flight_controller.configuration import cli_dump, rates
from swift_sim_bridge.flight_controller.configuration.controller_section import DumpedController
from swift_sim_bridge.flight_controller.configuration.dump_profile import profile_from_dump
from swift_sim_bridge.flight_controller.rate_loop.loop import LoopInput, initial_loop_state, rate_loop_step, take_frame
from swift_sim_bridge.flight_controller.rate_loop.stick_path import ReceiverFrame, Sticks
from swift_sim_bridge.flight_controller.sitl.replay import FRAME_PASSES
from swift_sim_bridge.flight_controller.sitl.sitl import LOOP_HZ

GYRO_COUNTS = 16.384  # a deg/s: resolution of SITL's gyro
MIN_CHECK_US = 1050  # Betaflight's min_check: throttle below it is zero
# Another delay than the last frame's is accepted if its squared error is smaller by this factor; with constant sticks
# all delays fit equally well.
DELAY_CHANGE_RATIO = 2.0
STICK_COLUMNS = (0, 1, 3)  # roll, pitch and yaw in a frame
LIMIT = 0.005  # accepted excess of the difference over run-to-run differences, as a share of the motors' range


@dataclass(frozen=True)
class Difference:
    """Differences of one set-up and sequence, RMS over passes and motors, as shares of the motors' range.

    Attributes:
        set_up, sequence: names.
        repeats: of the real runs from their mean.
        difference: of the simulated motors from a real run, with the estimated delay of each frame; the worst run.
        one_delay: the same with one delay for all frames.
    """

    set_up: str
    sequence: str
    repeats: float
    difference: float
    one_delay: float

    @property
    def excess(self) -> float:
        """Difference beyond that from run to run."""
        return self.difference - self.repeats


def controller_of(set_up: str) -> DumpedController:
    """Return the simulated controller with the same set-up."""
    dump = cli_dump.parse("\n".join([*INSTRUMENT, *SET_UPS[set_up], *LACKING]), set_up)
    return DumpedController(dump.settings, dump.features, dump.unmodelled, float(LOOP_HZ), 0.0, 4)


def simulated_motors(set_up: str, sequences: dict[str, Sequence], run: FirmwareRun, delay=None):
    """Return (motors (passes, 4) of each sequence, delay of each frame in passes).

    Args:
        set_up: name in SET_UPS.
        sequences: by name.
        run: of the real firmware, with its frame intervals.
        delay: passes after which frames are taken, one number or one for each frame; None: those that fit the motors
            of `run` best.
    """
    controller = controller_of(set_up)
    profile = jax.tree.map(lambda leaf: jnp.asarray(leaf, jnp.float32), profile_from_dump(controller))
    commands = partial(_commands, rates.rate_profile(controller))
    rest = still(SETTLED_FRAMES)
    loop = initial_loop_state(jnp.zeros((FRAME_PASSES, 3), jnp.float32), profile)
    frames = sum(len(sequence.frames_us) for sequence in sequences.values())
    given = None if delay is None else iter(np.broadcast_to(delay, frames))
    intervals_s = iter(run.intervals_s.astype(np.float32))
    old, motors, delays, late = commands(rest.frames_us[0]), {}, [], 0
    for name, sequence in {"": rest, **sequences}.items():
        rows = []
        for number, frame_us in enumerate(sequence.frames_us):
            part, new = slice(number * FRAME_PASSES, (number + 1) * FRAME_PASSES), commands(frame_us)
            gyro = _quantized(sequence.gyro_omega_body[part])
            loop, outputs = _frame(loop, old, new, gyro, profile, next(intervals_s))
            outputs = np.asarray(outputs)
            if name:
                late = _best_delay(outputs, run.motors[name][part], late) if given is None else int(next(given))
                delays.append(late)
            loop = _continue_from(loop, late)
            rows.append(outputs[:, late])
            old = new
        motors[name] = np.concatenate(rows)
    return {name: motors[name] for name in sequences}, np.array(delays)


def _best_delay(outputs, expected, last: int) -> int:
    """Return the delay (an index) whose outputs (passes, delays, 4) fit best.

    It is the last one unless another fits clearly better.
    """
    error = np.mean((outputs - expected[:, None]) ** 2, axis=(0, 2))
    return last if error[last] <= DELAY_CHANGE_RATIO * error.min() + 1e-10 else int(np.argmin(error))


def _commands(curves, frame_us):
    """Return (setpoint (3,) rad/s, throttle, deflection (3,)) of a frame, as `FlightController` makes them."""
    sticks_us = [frame_us[place] for place in STICK_COLUMNS]
    bands_us = curves.deadband_us
    deflection = [rates.deflection_of(sticks_us[i], i, MID_US, bands_us[i]) for i in range(3)]
    setpoint = np.radians([rates.rate_deg_s(curves, axis, deflection[axis]) for axis in range(3)])
    throttle = rates.throttle_share(frame_us[2], MIN_CHECK_US, curves)
    return tuple(np.asarray(value, np.float32) for value in (setpoint, throttle, deflection))


def _quantized(gyro_omega_body):
    """Return the gyro (..., 3) rad/s at the resolution of SITL."""
    return np.radians(np.rint(np.degrees(gyro_omega_body) * GYRO_COUNTS) / GYRO_COUNTS).astype(np.float32)


@jax.jit
def _frame(loop, old, new, gyro, profile, interval_s):
    """Return (loop, motors (passes, delays, 4)) of the passes of one frame, which row i takes after i passes."""
    delay, armed = jnp.arange(FRAME_PASSES), jnp.ones(FRAME_PASSES, bool)
    wide = lambda value: jnp.broadcast_to(value, (FRAME_PASSES, *value.shape))  # noqa: E731
    rows = [(wide(before), wide(after)) for before, after in zip(old, new, strict=True)]

    def run_pass(loop, step):
        number, sample = step
        setpoint, throttle, deflection = (jnp.where(_like(number >= delay, b), b, a) for a, b in rows)
        sticks = Sticks(deflection, ~armed)
        taken = take_frame(loop, ReceiverFrame(setpoint, throttle, armed, sticks, interval_s), profile)
        loop = jax.tree.map(lambda a, b: jnp.where(_like(number == delay, a), a, b), taken, loop)
        return rate_loop_step(loop, LoopInput(setpoint, throttle, wide(sample)), profile, 1.0 / LOOP_HZ)

    return jax.lax.scan(run_pass, loop, (jnp.arange(FRAME_PASSES), gyro))


@jax.jit
def _continue_from(loop, delay):
    """Return the loop of row `delay` in all rows. Compiled, because leaf by leaf it takes longer than the passes."""
    return jax.tree.map(lambda leaf: jnp.broadcast_to(leaf[delay], leaf.shape), loop)


def _like(chosen, values):
    """Return `chosen` (rows,) with as many axes as `values`."""
    return chosen.reshape(FRAME_PASSES, *[1] * (values.ndim - 1))


def compare(runs: list[FirmwareRun], set_up: str, sequences: dict[str, Sequence], progress) -> list[Difference]:
    """Return the differences of each sequence; the run with the largest difference counts.

    Args:
        runs: of the real firmware.
        set_up: name in SET_UPS.
        sequences: by name.
        progress: called with a line for each run.
    """
    each_delay, one_delay = [], []
    for number, run in enumerate(runs, start=1):
        motors, delays = simulated_motors(set_up, sequences, run)
        same_delay, _ = simulated_motors(set_up, sequences, run, delay=int(np.median(delays)))
        each_delay.append({name: _rms(motors[name] - run.motors[name]) for name in sequences})
        one_delay.append({name: _rms(same_delay[name] - run.motors[name]) for name in sequences})
        worst = 100 * max(each_delay[-1].values())
        progress(f"{set_up}: compared {number} of {len(runs)} runs, largest difference {worst:.3f} % of range")
    rows = []
    for name in sequences:
        mean = np.mean([run.motors[name] for run in runs], axis=0)
        spread = _rms(np.array([run.motors[name] - mean for run in runs]))
        worst = (max(each[name] for each in group) for group in (each_delay, one_delay))
        rows.append(Difference(set_up, name, spread, *worst))
    return rows


def _rms(values) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def table(rows: list[Difference]) -> str:
    """Return the differences as text, in percent of the motors' range, with the largest named."""
    percent = lambda share: f"{100 * share:.3f}"  # noqa: E731
    head = ("set-up", "sequence", "run to run %", "difference %", "excess %", "one delay for all frames %")
    shares = ((row, (row.repeats, row.difference, row.excess, row.one_delay)) for row in rows)
    body = [(row.set_up, row.sequence, *map(percent, figures)) for row, figures in shares]
    worst, exceeding = max(rows, key=lambda row: row.difference), max(rows, key=lambda row: row.excess)
    verdict = "all within" if exceeding.excess <= LIMIT else f"beyond, in {exceeding.set_up}, {exceeding.sequence},"
    last = f"worst difference: {worst.set_up}, {worst.sequence}: {percent(worst.difference)} %"
    return f"{align([head, *body])}\n{last}; {verdict} {100 * LIMIT} % above run to run"
