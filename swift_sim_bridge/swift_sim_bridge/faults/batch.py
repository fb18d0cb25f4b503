"""Many races with faults: each remembered in a file, so that a batch continues; some at the same time, if asked."""

import contextlib
import dataclasses
import functools
import json
import multiprocessing
import os
import shutil
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import numpy as np
import yaml

from swift_ros.errors import UsageError
from swift_ros.graph.runner import die_with_parent
from swift_ros.race.result import BAG
from swift_sim_bridge.faults.catalogue import REAL_TIME, Fault, draw
from swift_sim_bridge.faults.ending import LANDED, Ending, ending_of
from swift_sim_bridge.faults.injection import fly
from swift_sim_bridge.racing.race import RaceOptions

ENDING = "ending.json"
REPEATS = 2  # of a race that ends before its fault: in real time, on a machine that does other work too
CHANGED = ("track.yaml", "simulation.yaml")
BLUR_POSES = 1  # no motion blur: with it, two cores do not always draw 30 images a second beside the graph
LAPS = 1  # a fault meets each part of the track within a lap


@dataclasses.dataclass(frozen=True)
class Batch:
    """How to fly a batch.

    Attributes:
        out: folder with a subfolder for each draw.
        config: configuration folder.
        keep: keep the bags of defined endings too.
        jobs: races at the same time.
        progress: called with each line to print; by processes of their own if there are more jobs than one.
    """

    out: Path
    config: Path
    keep: bool
    jobs: int = 1
    progress: Callable[[str], None] = functools.partial(print, flush=True)

    def folder(self, seed: int) -> Path:
        """Return the folder of a draw."""
        return self.out / f"draw-{seed}"


def short_race(config: Path, out: Path) -> Path:
    """Return a new configuration folder in `out`, as `config`, with one lap and with images that are drawn faster."""
    folder = out / "config"
    track, simulation = (yaml.safe_load((config / name).read_text()) for name in CHANGED)
    track["laps"], simulation["renderer"]["blur_poses"] = LAPS, BLUR_POSES
    shutil.copytree(config, folder, dirs_exist_ok=True)  # what changes in `config` later shall not change the races
    for name, content in zip(CHANGED, (track, simulation), strict=True):
        (folder / name).write_text(yaml.safe_dump(content))
    return folder


def endings(batch: Batch, seeds: list[int]) -> list[Ending]:
    """Fly the draws that have no ending yet; return the endings of all, in the order of the seeds."""
    with _workers(batch.jobs) as apply:
        return list(apply(functools.partial(_ending, batch), seeds))


@contextlib.contextmanager
def _workers(jobs: int) -> Iterator[Callable]:
    """Yield `map`, or its equivalent with processes; an interruption ends them too.

    Raises UsageError when there are fewer processor cores than jobs.
    """
    if jobs == 1:
        yield map
        return
    cores = sorted(os.sched_getaffinity(0))
    if jobs > len(cores):
        raise UsageError(f"--jobs {jobs} needs as many processor cores, and {len(cores)} are here; give fewer")
    context = multiprocessing.get_context("spawn")  # a fork would share what rclpy keeps
    shares = context.SimpleQueue()
    for share in np.array_split(cores, jobs):
        shares.put(share.tolist())
    with ProcessPoolExecutor(jobs, context, _begin_work, (os.getpid(), shares)) as pool:

        def apply(function, values):
            return [future.result() for future in [pool.submit(function, value) for value in values]]

        try:
            yield apply
        except BaseException:
            for process in multiprocessing.active_children():
                process.terminate()  # its nodes end with it
            raise


def _begin_work(parent: int, shares) -> None:
    """Bind a worker to its parent's life and to its share of the cores, so that no race makes another late."""
    die_with_parent(parent)()
    os.sched_setaffinity(0, shares.get())


def _ending(batch: Batch, seed: int) -> Ending:
    """Return the ending of a draw, which is flown when it has none yet."""
    fault, path = draw(seed), batch.folder(seed) / ENDING
    if path.is_file():
        return read_ending(path)
    batch.progress(f"draw {seed}: {fault.sentence}")
    ending = _fly(batch, fault)
    path.write_text(json.dumps(dataclasses.asdict(ending), indent=1) + "\n")
    batch.progress(f"draw {seed} {ending.way}: {ending.reason}")
    for problem in ending.problems:
        batch.progress(f"draw {seed} UNDEFINED: {problem}")
    return ending


def _fly(batch: Batch, fault: Fault) -> Ending:
    folder, real_time = batch.folder(fault.seed), fault.clock == REAL_TIME
    options = RaceOptions(batch.config, folder, real_time, "local", progress=lambda line: None)
    for attempt in range(1 + REPEATS):
        shutil.rmtree(folder, ignore_errors=True)  # of a draw that was interrupted, or of the last attempt
        try:
            flown = fly(fault, options)
        except UsageError as error:
            return Ending(fault, LANDED, "", None, None, (f"a node refused its input: {error}",))
        if flown.fault_ns is not None:
            break
        reason = flown.end.text if flown.end else "no end"
        batch.progress(f"draw {fault.seed}: attempt {attempt + 1}: the race ended before the fault ({reason})")
    ending = ending_of(fault, flown, folder)
    if not ending.problems and not batch.keep:
        shutil.rmtree(folder / BAG, ignore_errors=True)
    return ending


def read_ending(path: Path) -> Ending:
    """Return the ending in a file. Raises UsageError when it is not one."""
    try:
        values = json.loads(path.read_text())
        fault, problems = Fault(**values["fault"]), tuple(values["problems"])
        return Ending(**values | {"fault": fault, "problems": problems})
    except (ValueError, TypeError, KeyError) as error:
        raise UsageError(f"{path} is not the ending of a draw; delete it to fly the draw again") from error
