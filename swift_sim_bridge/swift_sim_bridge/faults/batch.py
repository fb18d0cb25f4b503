"""Many races with faults: flown one after the other, each remembered in a file, so that a batch continues."""

import dataclasses
import json
import os
import shutil
from collections.abc import Callable
from pathlib import Path

import yaml

from swift_ros.errors import UsageError
from swift_ros.race.result import BAG
from swift_sim_bridge.faults.catalogue import REAL_TIME, Fault, draw
from swift_sim_bridge.faults.ending import Ending, ending_of
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
        progress: called with each line to print.
    """

    out: Path
    config: Path
    keep: bool
    progress: Callable[[str], None]

    def folder(self, seed: int) -> Path:
        """Return the folder of a draw."""
        return self.out / f"draw-{seed}"


def short_race(config: Path, out: Path) -> Path:
    """Return a new configuration folder in `out`, as `config`, with one lap and with images that are drawn faster."""
    folder = out / "config"
    folder.mkdir(parents=True, exist_ok=True)
    track, simulation = (yaml.safe_load((config / name).read_text()) for name in CHANGED)
    track["laps"], simulation["renderer"]["blur_poses"] = LAPS, BLUR_POSES
    for path in config.iterdir():
        if path.name not in CHANGED and not (folder / path.name).exists():
            os.symlink(path.resolve(), folder / path.name)
    for name, content in zip(CHANGED, (track, simulation), strict=True):
        (folder / name).write_text(yaml.safe_dump(content))
    return folder


def endings(batch: Batch, seeds: list[int]) -> list[Ending]:
    """Fly the draws that have no ending yet; return the endings of all."""
    found = []
    for count, seed in enumerate(seeds):
        fault, path = draw(seed), batch.folder(seed) / ENDING
        if path.is_file():
            found.append(read_ending(path))
            continue
        batch.progress(f"draw {seed}, {count + 1} of {len(seeds)}: {fault.sentence}")
        found.append(_fly(batch, fault))
        path.write_text(json.dumps(dataclasses.asdict(found[-1]), indent=1) + "\n")
        batch.progress(f"  {found[-1].way}: {found[-1].reason}")
        for problem in found[-1].problems:
            batch.progress(f"  UNDEFINED: {problem}")
    return found


def _fly(batch: Batch, fault: Fault) -> Ending:
    folder, real_time = batch.folder(fault.seed), fault.clock == REAL_TIME
    options = RaceOptions(batch.config, folder, real_time, "local", progress=lambda line: None)
    for attempt in range(1 + REPEATS):
        shutil.rmtree(folder, ignore_errors=True)  # of a draw that was interrupted, or of the last attempt
        flown = fly(fault, options)
        if flown.fault_ns is not None:
            break
        reason = flown.end.text if flown.end else "no end"
        batch.progress(f"  attempt {attempt + 1}: the race ended before the fault ({reason})")
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
