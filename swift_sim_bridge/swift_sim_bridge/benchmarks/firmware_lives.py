"""Lives of the real firmware on the sequences that both are fed, each kept in a file as soon as it is over.

A comparison that was interrupted goes on where it stopped. A life that failed is tried again. The firmware takes its
sticks when its clock says so, which follows the wall's: lives want a quiet machine, but no real-time priority, in which
its threads would keep one another from the sticks.
"""

import hashlib
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from swift_ros.errors import UsageError
from swift_sim_bridge.benchmarks.firmware_sequences import INSTRUMENT, MID_US, SET_UPS, Sequence, still
from swift_sim_bridge.flight_controller.sitl import pass_clock
from swift_sim_bridge.flight_controller.sitl.program import executable
from swift_sim_bridge.flight_controller.sitl.replay import FRAME_PASSES, FRAME_TIMES, FrameTimes, arm, replay
from swift_sim_bridge.flight_controller.sitl.sitl import AT_REST, Sitl

SETTLED_FRAMES = 150  # at rest before the first sequence: the firmware measures the rate of the frames
SILENT_FRAMES = 8  # left out before these: after such a break it counts anew the frames from cutoff to cutoff
TRIES = 5  # of a life
INTERVALS_S = "intervals_s"


@dataclass(frozen=True)
class Life:
    """motors: (passes, 4) of each sequence, in order, without a break; intervals_s: (frames,) from the frame before to
    each, at rest and then of the sequences, by the firmware's own clock."""

    motors: dict[str, np.ndarray]
    intervals_s: np.ndarray


def live(binary, set_up: str, fed: dict[str, Sequence]) -> Life:
    """Return one life of the real firmware. Raises UsageError as `Sitl`."""
    rest = still(SETTLED_FRAMES)
    safe_us = [MID_US, MID_US, 1000, MID_US, 1000]
    lines = [*INSTRUMENT, FRAME_TIMES, *SET_UPS[set_up]]
    with tempfile.TemporaryDirectory() as folder, Sitl(binary, folder, lines, counted=True) as sitl:
        sitl.await_calibration()
        arm(sitl, safe_us, list(rest.frames_us[0]))
        for _ in range(SILENT_FRAMES * FRAME_PASSES):
            sitl.step(*AT_REST)
        watch = FrameTimes(sitl)
        replay(sitl, rest.gyro_omega_body, rest.frames_us, watch)
        motors = {name: replay(sitl, one.gyro_omega_body, one.frames_us, watch) for name, one in fed.items()}
        return Life(motors, watch.intervals_s())


def lives(binary, set_up: str, fed: dict[str, Sequence], repeats: int, folder: Path, tell) -> list[Life]:
    """Return `repeats` lives, those that `folder` holds already not lived again.

    tell: called with a line for each. Raises UsageError for a life that has failed TRIES times.
    """
    found, folder = [], Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    told = _fingerprint(executable(binary), set_up, fed)
    for number in range(1, repeats + 1):
        path, what = folder / f"{set_up}-{number}-{told}.npz", f"{set_up}: life {number} of {repeats}"
        if path.exists():
            tell(f"{what} is there already")
        else:
            life = _patiently(binary, set_up, fed, what, tell)
            _keep(path, life)
            tell(f"{what} is over, with {1.0 / np.median(life.intervals_s):.1f} frames a second by its own clock")
        with np.load(path) as kept:
            found.append(Life({name: kept[name] for name in fed}, kept[INTERVALS_S]))
    return found


def _patiently(binary, set_up: str, fed: dict[str, Sequence], what: str, tell) -> Life:
    for attempt in range(1, TRIES + 1):
        try:
            return live(binary, set_up, fed)
        except UsageError as error:
            if attempt == TRIES:
                raise
            tell(f"{what} failed, try {attempt} of {TRIES}: {error}")


def _keep(path: Path, life: Life) -> None:
    """Write the file whole or not at all."""
    part = path.with_suffix(".part")
    with open(part, "wb") as file:
        np.savez_compressed(file, **life.motors, **{INTERVALS_S: life.intervals_s})
    part.replace(path)


def _fingerprint(binary: Path, set_up: str, fed: dict[str, Sequence]) -> str:
    """Return what tells lives of other programs, set-ups and sequences apart, for a file's name."""
    digest = hashlib.sha256(binary.read_bytes() + pass_clock.SOURCE.read_bytes())
    digest.update("\n".join([*INSTRUMENT, FRAME_TIMES, *SET_UPS[set_up]]).encode())
    for name, one in fed.items():
        digest.update(name.encode() + one.frames_us.tobytes() + one.gyro_omega_body.tobytes())
    return digest.hexdigest()[:12]
