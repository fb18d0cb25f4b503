"""Runs of the real firmware on the benchmark's sequences, each saved to a file when it is done.

An interrupted comparison resumes; a failed run is repeated. The firmware reads its sticks by its own clock, which
follows the system clock. Runs therefore need an idle machine, but no real-time priority, under which the firmware's
threads would block one another.
"""

import hashlib
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from swift_ros.errors import UsageError
from swift_sim_bridge.benchmarks.firmware_sequences import INSTRUMENT, MID_US, SET_UPS, Sequence, still
from swift_sim_bridge.flight_controller.sitl import pass_clock
from swift_sim_bridge.flight_controller.sitl.program import executable
from swift_sim_bridge.flight_controller.sitl.replay import FRAME_PASSES, FRAME_TIMES, FrameTimes, arm, replay
from swift_sim_bridge.flight_controller.sitl.sitl import AT_REST, Sitl

SETTLED_FRAMES = 150  # at rest before the first sequence, in which the firmware measures the frame rate
SILENT_FRAMES = 8  # a pause before these, after which the firmware starts its measurement again
TRIES = 5  # of a run
INTERVALS_S = "intervals_s"  # key in the saved file


@dataclass(frozen=True)
class FirmwareRun:
    """The recording of one run of the firmware.

    Attributes:
        motors: (passes, 4) motor commands, 0..1, of each sequence, in order, without a pause between them.
        intervals_s: (frames,) from the previous frame to each, at rest and then of the sequences, by the firmware's
            own clock.
    """

    motors: dict[str, np.ndarray]
    intervals_s: np.ndarray


def run_firmware(binary, set_up: str, sequences: dict[str, Sequence]) -> FirmwareRun:
    """Run the firmware once on all sequences. Raises UsageError as `Sitl`."""
    rest = still(SETTLED_FRAMES)
    safe_us = [MID_US, MID_US, 1000, MID_US, 1000]
    lines = [*INSTRUMENT, FRAME_TIMES, *SET_UPS[set_up]]
    with tempfile.TemporaryDirectory() as folder, Sitl(binary, folder, lines, counted=True) as sitl:
        sitl.await_calibration()
        arm(sitl, safe_us, list(rest.frames_us[0]))
        for _ in range(SILENT_FRAMES * FRAME_PASSES):
            sitl.step(*AT_REST)
        times = FrameTimes(sitl)
        replay(sitl, rest.gyro_omega_body, rest.frames_us, times)
        motors = {name: replay(sitl, part.gyro_omega_body, part.frames_us, times) for name, part in sequences.items()}
        return FirmwareRun(motors, times.intervals_s())


def firmware_runs(
    binary, set_up: str, sequences: dict[str, Sequence], repeats: int, folder: Path, progress
) -> list[FirmwareRun]:
    """Return runs of the firmware; those that are saved already are read.

    Args:
        binary: path of a Betaflight SITL binary.
        set_up: name in SET_UPS.
        sequences: by name.
        repeats: number of runs.
        folder: of the saved runs.
        progress: called with a line for each run.

    Raises:
        UsageError: a run has failed TRIES times.
    """
    runs, folder = [], Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    fingerprint = _fingerprint(executable(binary), set_up, sequences)
    for number in range(1, repeats + 1):
        path, name = folder / f"{set_up}-{number}-{fingerprint}.npz", f"{set_up}: run {number} of {repeats}"
        if path.exists():
            progress(f"{name} is saved already")
        else:
            run = _run_with_retries(partial(run_firmware, binary, set_up, sequences), name, progress)
            _save(path, run)
            progress(f"{name} is done: {1.0 / np.median(run.intervals_s):.1f} frames a second by the firmware's clock")
        with np.load(path) as saved:
            runs.append(FirmwareRun({key: saved[key] for key in sequences}, saved[INTERVALS_S]))
    return runs


def _run_with_retries(run: Callable[[], FirmwareRun], name: str, progress) -> FirmwareRun:
    """Return the result of `run`, called again after a failure. Raises UsageError after TRIES failures."""
    for attempt in range(1, TRIES + 1):
        try:
            return run()
        except UsageError as error:
            if attempt == TRIES:
                raise
            progress(f"{name} failed, try {attempt} of {TRIES}: {error}")


def _save(path: Path, run: FirmwareRun) -> None:
    """Write a run; the file is written completely or not at all."""
    partial_file = path.with_suffix(".part")
    with open(partial_file, "wb") as file:
        np.savez_compressed(file, **run.motors, **{INTERVALS_S: run.intervals_s})
    partial_file.replace(path)


def _fingerprint(binary: Path, set_up: str, sequences: dict[str, Sequence]) -> str:
    """Return a hash of the program, the set-up and the sequences, for the names of the saved runs."""
    digest = hashlib.sha256(binary.read_bytes() + pass_clock.SOURCE.read_bytes())
    digest.update("\n".join([*INSTRUMENT, FRAME_TIMES, *SET_UPS[set_up]]).encode())
    for name, part in sequences.items():
        digest.update(name.encode() + part.frames_us.tobytes() + part.gyro_omega_body.tobytes())
    return digest.hexdigest()[:12]
