"""One soak: a command of swiftros runs for a long time, and what it does is written down every minute."""

import dataclasses
import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from scipy.stats import theilslopes

from swift_ros.errors import UsageError
from swift_ros.graph.domain import free_domain
from swift_ros.graph.runner import die_with_parent
from swift_sim_bridge.soak.processes import memory_mb
from swift_sim_bridge.soak.watcher import Watcher

SIM, RACES = "sim", "races"
FIRST_SEED, SEEDS = 5000, 1000  # of the races
SAMPLE_S = 5.0  # s between two readings of the memory
FLIGHT_S, PAUSE_S = 30.0, 8.0  # s that the simulator flies, and s in which it lands and arms again
END_S = 30.0  # s, longest time for an orderly end
SETTLED_MIN = 5  # minutes after which the memory must not grow
MAX_GROWTH = 0.02  # share
RESULT = "soak.json"


@dataclasses.dataclass
class Minute:
    """One minute of a soak.

    Attributes:
        minute: number, from 0.
        memory_mb: largest memory by program, MB.
        commands: number of commands that were answered by a frame.
        late: (late s, stalled s) of each late command that the machine's stalls explain.
        unexplained: likewise of each other one.
    """

    minute: int
    memory_mb: dict[str, float]
    commands: int = 0
    late: list[tuple[float, float]] = dataclasses.field(default_factory=list)
    unexplained: list[tuple[float, float]] = dataclasses.field(default_factory=list)


def soak(kind: str, minutes: int, out: Path, progress: Callable[[str], None]) -> list[Minute]:
    """Run the simulator (SIM) or races in real time (RACES) and return what was watched, by minute.

    Raises:
        UsageError: the command has ended early.
    """
    domain, reservation = free_domain()
    watcher = Watcher(domain, flies=kind == SIM)
    environment = os.environ | {"ROS_DOMAIN_ID": str(domain)}
    with open(out / "command.log", "wb") as log:
        process = subprocess.Popen(
            [sys.executable, "-m", "swift_ros.cli", *_words(kind, out)],
            stdin=subprocess.PIPE,
            stdout=log,
            stderr=subprocess.STDOUT,
            preexec_fn=die_with_parent(os.getpid()),
            env=environment,
        )
    try:
        return _watch(kind, minutes, out, process, watcher, progress)
    finally:
        process.send_signal(signal.SIGTERM)
        try:
            process.wait(END_S)
        except subprocess.TimeoutExpired:
            process.kill()
        watcher.close()
        if reservation:
            reservation.close()


@dataclasses.dataclass(frozen=True)
class Growth:
    """By which share the memory of all programs grows from SETTLED_MIN to the end.

    Attributes:
        share: of the median memory.
        low, high: 95 % interval of the share.
    """

    share: float
    low: float
    high: float


def growth(minutes: list[Minute]) -> Growth:
    """Return how the memory of all programs grows after SETTLED_MIN; 0 where less than three minutes follow.

    It is Sen's slope, the median of the slopes between all pairs of minutes: a minute's largest memory depends on how
    much of a race lies in it, so that the largest of many minutes exceeds the first one without any growth.
    """
    totals = np.array([sum(minute.memory_mb.values()) for minute in minutes])
    settled = np.flatnonzero(totals)[np.flatnonzero(totals) >= SETTLED_MIN]
    if len(settled) < 3:
        return Growth(0.0, 0.0, 0.0)
    trend = theilslopes(totals[settled], settled)
    shares = (settled[-1] - settled[0]) / np.median(totals[settled]) * np.array([trend[0], trend[2], trend[3]])
    return Growth(*(float(share) for share in shares))


def _words(kind: str, out: Path) -> list[str]:
    if kind == SIM:
        return ["sim", "--no-images", "--out", str(out / "sim")]
    seeds = ["--first-seed", str(FIRST_SEED), "--seeds", str(SEEDS)]
    return ["race", "--real-time", *seeds, "--out", str(out / "races")]


def _watch(kind, minutes, out, process, watcher, progress) -> list[Minute]:
    found: list[Minute] = []
    begun_s = time.monotonic()
    flights, sampler = _Flights(process, begun_s), _MemorySampler(process.pid)
    while (elapsed_s := time.monotonic() - begun_s) < 60 * minutes:
        watcher.spin()
        if process.poll() is not None:
            raise UsageError(f"swiftros {kind} ended after {elapsed_s:.0f} s; see {out / 'command.log'}")
        if int(elapsed_s // 60) == len(found):
            found.append(Minute(len(found), {}))
            _write(out, found)
            progress(f"minute {len(found)} of {minutes}")
        for name, size_mb in sampler.take().items():
            found[-1].memory_mb[name] = max(found[-1].memory_mb.get(name, 0.0), round(size_mb, 2))
        found[-1].commands += watcher.commands
        watcher.commands = 0
        for late in watcher.late:
            rows = found[-1].late if late.is_explained else found[-1].unexplained
            rows.append((round(late.late_s, 4), round(late.stalled_s, 4)))
        watcher.late.clear()
        if kind == SIM:
            flights.go_on()
    _write(out, found)
    return found


class _MemorySampler:
    """Reads the memory every SAMPLE_S in a thread: a reading takes 0.1 s, in which the pilot may not be silent."""

    def __init__(self, process_id: int):
        self._process_id, self._sizes_mb = process_id, {}
        threading.Thread(target=self._work, name="memory", daemon=True).start()

    def _work(self) -> None:
        while True:
            time.sleep(SAMPLE_S)
            self._sizes_mb = memory_mb(self._process_id)

    def take(self) -> dict[str, float]:
        """Return the reading since the last call, MB by program; {} without one."""
        sizes_mb, self._sizes_mb = self._sizes_mb, {}
        return sizes_mb


class _Flights:
    """Types the requests of one flight after the other into `swiftros sim`."""

    def __init__(self, process: subprocess.Popen, now_s: float):
        self._process, self._due_s = process, now_s + FLIGHT_S
        self._steps = [("arm", 2.0), ("start", FLIGHT_S), ("stop", PAUSE_S)]

    def go_on(self) -> None:
        """Type the next request when it is due."""
        if time.monotonic() >= self._due_s:
            request, wait_s = self._steps[0]
            self._steps = [*self._steps[1:], self._steps[0]]
            self._due_s = time.monotonic() + wait_s
            self._process.stdin.write(f"{request}\n".encode())
            self._process.stdin.flush()


def _write(out: Path, minutes: list[Minute]) -> None:
    (out / RESULT).write_text(json.dumps([dataclasses.asdict(minute) for minute in minutes], indent=1) + "\n")
