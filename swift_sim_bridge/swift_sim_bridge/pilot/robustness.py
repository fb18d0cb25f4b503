"""What a pilot withstands: races of the batched simulator with one thing different from what it was trained for."""

from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from swift_ros import configuration
from swift_ros.camera.model import Camera
from swift_ros.race import limit
from swift_ros.track import Track
from swift_ros.vehicle import Vehicle
from swift_sim_bridge.pilot import export, networks, trial
from swift_sim_bridge.pilot.episodes.randomization import Disturbance
from swift_sim_bridge.pilot.episodes.world import make_world
from swift_sim_bridge.pilot.job import read_settings
from swift_sim_bridge.pilot.learner import CRITIC_SIZE, OBSERVATION_SIZE

IDEAL = "true state, no delays, the vehicle of the file"  # what the line itself is worth
DISTURBANCES = {
    IDEAL: Disturbance(),
    "as in the training": Disturbance(),
    "mass -5 %": Disturbance(mass=0.95),
    "mass +5 %": Disturbance(mass=1.05),
    "thrust -7 %": Disturbance(thrust=0.93),
    "thrust +7 %": Disturbance(thrust=1.07),
    "drag x 2": Disturbance(drag=2.0),
    "commands 10 ms later": Disturbance(delay_s=0.01),
    "commands 20 ms later": Disturbance(delay_s=0.02),
    "commands 30 ms later": Disturbance(delay_s=0.03),
    "commands 40 ms later": Disturbance(delay_s=0.04),
    "errors of the estimate x 2": Disturbance(error=2.0),
    "battery a quarter empty": Disturbance(used_share=0.25),
}


class Files(NamedTuple):
    """The files of a pilot and its races."""

    folder: Path
    pilot: Path
    track: Path
    vehicle: Path


def measure(files: Files, races: int, seed: int, progress=print) -> dict[str, dict]:
    """Return the figures of `trial.figures` by disturbance, and `lap_ratio` to the limit as flown where it is known.

    Args:
        files: of the pilot.
        races: of each disturbance.
        seed: of starts, episodes and errors; the same races for each disturbance.
        progress: called with lines of text.

    Raises:
        UsageError: bad input.
    """
    settings = read_settings(files.folder)
    vehicle, track = configuration.load(Vehicle, files.vehicle), configuration.load(Track, files.track)
    camera = configuration.load(Camera, files.folder / "camera.yaml")
    world = make_world(track, vehicle, camera, settings.environment, settings.estimate_errors)
    key = jax.random.PRNGKey(seed)
    like = networks.make_actor_and_critic(key, OBSERVATION_SIZE, CRITIC_SIZE)["actor"]
    actor = export.read_actor(files.pilot, like)
    fly = trial.compile_races(world, races)
    known = limit.find(files.folder, track, vehicle)
    result = {}
    for name, disturbance in DISTURBANCES.items():
        difficulty = jnp.float32(name != IDEAL)
        flown = fly(actor, key, difficulty, Disturbance(*map(np.float32, disturbance)))
        result[name] = trial.figures(flown, len(track.gates))
        if known:
            result[name]["lap_ratio"] = result[name]["median_lap_s"] / known.as_flown.whole_lap_s
        progress(f"{len(result)} of {len(DISTURBANCES)}: {name}")
    return result


def table(result: dict[str, dict]) -> list[tuple[str, ...]]:
    """Return the rows of the table."""
    rows = [("", "finished", "lap s", "times limit", "best lap s", "mean margin m")]
    for name, row in result.items():
        ratio = f"{row['lap_ratio']:.3f}" if "lap_ratio" in row else "-"
        finished = f"{round(row['finish_rate'] * row['races'])} of {row['races']}"
        lap, best = (f"{row[f'{which}_lap_s']:.2f}" for which in ("median", "best"))
        rows.append((name, finished, lap, ratio, best, f"{row['mean_margin_m']:.2f}"))
    return rows
