"""Recordings as other people's loggers write them: rows slower than the rate loop, and other faults of a logger.

The instruments are those of `instruments`. The logger takes some of their samples, and writes commands, stamps and
numbers in its own way.
"""

from dataclasses import asdict, dataclass

import numpy as np

from swift_ros.recording.flight_checks import checked_table
from swift_ros.recording.flight_table import FlightTable, Samples
from swift_sim_bridge.referee.simulator import instruments
from swift_sim_bridge.referee.simulator.flight import LOOP_HZ, LOOP_S, Truth

DIVISORS = (2, 3, 4, 10)  # of the loop's rate
COMMANDS = ("held", "mean", "late")  # what a row has of the commands
COMMAND_CHANNELS = ("motor_command", "thrust_command", "omega_command_body")
LATE = (0.2, 0.8)  # of a row, by which late commands are older than the row
JITTER = (0.02, 0.1)  # of a row: standard deviation of the stamps
LOST = (0.005, 0.03)  # share of the rows
LONGEST_LOSS = 3  # rows lost one after the other
DEGREES_OF_FREEDOM = 5.0  # of Student's t, the noise with outliers
RESOLUTION = {  # of the numbers of a coarse logger
    "p_world": 1e-3,
    "v_world": 1e-2,
    "q_world_body": 1e-4,
    "gyro_body": np.pi / 180.0 / 16.4,
    "specific_force_body": 9.80665 / 2048.0,
    "rotor_speed": 2.0 * np.pi / 60.0 * 100.0 / 7.0,
    "motor_command": 1e-3,
    "voltage": 0.01,
    "current": 0.1,
}


@dataclass(frozen=True)
class Logger:
    """How a recording is written.

    Attributes:
        divisor: passes of the rate loop for each row.
        commands: `held`: the command set at the row; `mean`: the mean since the row before; `late`: an older one.
        late: age of a late command, as share of a row.
        jitter: standard deviation of the rows' stamps, as share of a row.
        lost: share of the rows that are lost.
        outliers: whether the noise of the sensors is Student's instead of normal.
        coarse: whether the numbers have the steps RESOLUTION.
    """

    divisor: int
    commands: str = "held"
    late: float = 0.0
    jitter: float = 0.0
    lost: float = 0.0
    outliers: bool = False
    coarse: bool = False

    @property
    def notes(self) -> dict:
        """The entries of a sealed answer."""
        return {"logger": asdict(self)}


class _Outliers:
    """A random generator whose standard normal numbers are Student's, scaled to variance 1."""

    def __init__(self, rng: np.random.Generator):
        self.rng, self.uniform = rng, rng.uniform

    def standard_normal(self, size):
        """Return random numbers of variance 1."""
        return self.rng.standard_t(DEGREES_OF_FREEDOM, size) * np.sqrt(1.0 - 2.0 / DEGREES_OF_FREEDOM)


def draw_logger(rng: np.random.Generator) -> Logger:
    """Return a random logger; each fault but the slow rows is in half of them."""
    commands = str(rng.choice(COMMANDS))
    some = rng.random(4) < 0.5
    late, jitter, lost = (float(rng.uniform(*bounds)) for bounds in (LATE, JITTER, LOST))
    return Logger(
        divisor=int(rng.choice(DIVISORS)),
        commands=commands,
        late=late if commands == "late" else 0.0,
        jitter=jitter if some[0] else 0.0,
        lost=lost if some[1] else 0.0,
        outliers=bool(some[2]),
        coarse=bool(some[3]),
    )


def record(truth: Truth, content: dict, rng: np.random.Generator, logger: Logger, channels, name: str) -> FlightTable:
    """Return the recording of a flight by a logger; for the other arguments see `instruments.record`."""
    noise = _Outliers(rng) if logger.outliers else rng
    dense = instruments.record(truth, content, noise, channels=channels, name=name)
    first, step = round(instruments.LEAD_S * LOOP_HZ), logger.divisor
    passes = np.arange(first + step, len(truth.t), step)
    passes = passes[~_lost(len(passes), logger.lost, rng)]
    t = truth.t[passes] - instruments.LEAD_S
    stamps = t + step * LOOP_S * np.clip(logger.jitter * rng.standard_normal(len(t)), -0.4, 0.4)
    written = {}
    for channel, samples in dense.channels.items():
        if channel in COMMAND_CHANNELS:
            written[channel] = Samples(stamps, _commands(truth, channel, passes, logger))
        elif len(samples.t) == len(truth.t) - first:
            written[channel] = Samples(stamps, samples.values[passes - first])
        else:
            written[channel] = samples  # with a clock of its own
    if logger.coarse:
        written = {key: _rounded(samples, RESOLUTION.get(key)) for key, samples in written.items()}
    return checked_table(name, written)


def _lost(count: int, share: float, rng) -> np.ndarray:
    """Return which rows (n,) are lost, in runs of up to LONGEST_LOSS."""
    lost, starts = np.zeros(count, bool), rng.random(count) < share / (0.5 * (1 + LONGEST_LOSS))
    for start in np.flatnonzero(starts[1:-LONGEST_LOSS]) + 1:
        lost[start : start + rng.integers(1, LONGEST_LOSS + 1)] = True
    return lost


def _commands(truth: Truth, channel: str, passes, logger: Logger) -> np.ndarray:
    """Return a channel of commands as the logger writes it in the rows at these passes (n,)."""
    if channel == "motor_command":
        dense = truth.u
    else:
        newest = np.searchsorted(truth.t_command, truth.t + 1e-9, "right") - 1
        dense = (truth.thrust if channel == "thrust_command" else truth.rates)[np.maximum(newest, 0)]
    if logger.commands == "mean":
        return np.mean([dense[passes - back] for back in range(logger.divisor)], axis=0)
    return dense[passes - round(logger.late * logger.divisor)]


def _rounded(samples: Samples, resolution: float | None) -> Samples:
    """Return samples in steps of a resolution; unchanged without one."""
    if resolution is None:
        return samples
    return Samples(samples.t, resolution * np.round(samples.values / resolution))
