"""The training of the policy around `algorithm`: trial races, checkpoints, log, and the export of the best policy.

One compiled call makes all updates between two trials. After each trial `training.npz` is saved, `progress.jsonl` gets
a line, and a policy that is better than all before is exported. The same call resumes an interrupted training.
"""

import functools
import json
import shlex
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

from swift_ros import configuration
from swift_ros.errors import UsageError
from swift_sim_bridge.model_files import checkpoint, provenance
from swift_sim_bridge.pilot import export, trial
from swift_sim_bridge.pilot.algorithm import PolicySettings, Training, begin, compile_updates, schedule_at
from swift_sim_bridge.pilot.world import World, read_world, world_files


@dataclass(frozen=True)
class TrainingOptions:
    """What to train.

    Attributes:
        folder: configuration folder.
        out: folder of checkpoints, log and model.
        seed: of networks, races and noise.
        vehicle: vehicle file in place of the folder's; None: the folder's.
        start_from: best.npz of another training, whose networks are the first; None: random networks.
    """

    folder: Path
    out: Path
    seed: int = 0
    vehicle: Path | None = None
    start_from: Path | None = None


@dataclass(frozen=True)
class TrainingJob:
    """What stays the same during one training.

    Attributes:
        world: track, vehicle and settings as arrays.
        settings: of the algorithm.
        out: folder of checkpoints, log and model.
        fingerprint: identifies configuration, seed and first networks; a checkpoint of another one is refused.
        race: (actor, key, difficulty=...) -> Trial, compiled.
        export: (networks, figures) writes the model.
    """

    world: World
    settings: PolicySettings
    out: Path
    fingerprint: str
    race: Callable
    export: Callable

    @property
    def gates(self) -> int:
        """Number of gates of the track."""
        return len(self.world.gates.yaws)


def read_settings(folder: Path) -> PolicySettings:
    """Return section `policy` of training.yaml in a configuration folder. Raises UsageError."""
    return configuration.load_section(PolicySettings, folder / "training.yaml", "policy")


def train_policy(options: TrainingOptions) -> None:
    """Train a policy, or resume the training in `options.out`. Raises UsageError on bad input."""
    settings = read_settings(options.folder)
    job = _prepare(options, settings)
    training = _first_state(options, job)
    best = train(job, training)
    networks = checkpoint.load(options.out / "best.npz", training.networks, fingerprint=None)
    final = confirm(job, networks, options.seed)
    job.export(networks, best | {"final": final})
    print(f"best policy, in {settings.final_races} races that did not select it: {describe(final)}")
    print(f"it is {options.out / 'pilot.onnx'}; copy it and pilot.json to config/models to fly it")


def _prepare(options: TrainingOptions, settings: PolicySettings) -> TrainingJob:
    """Return the job of a training; make its folder."""
    files = world_files(options.folder, options.vehicle)
    world = read_world(files, settings.environment)
    if options.start_from and not options.start_from.is_file():
        raise UsageError(f"--start-from names {options.start_from}, which does not exist; name a best.npz")
    options.out.mkdir(parents=True, exist_ok=True)
    configuration_sha256 = provenance.configuration_hash(files, settings)
    start_sha256 = provenance.file_hash(options.start_from) if options.start_from else ""
    write = functools.partial(
        export.write_pilot,
        options.out,
        command=_command(options),
        configuration=configuration_sha256,
        seed=options.seed,
    )
    race = jax.jit(functools.partial(trial.fly, world, races=settings.trial_races))
    fingerprint = f"{configuration_sha256} {options.seed} {start_sha256}"
    return TrainingJob(world, settings, options.out, fingerprint, race, write)


def _command(options: TrainingOptions) -> str:
    """Return the command line that reproduces a training."""
    files = {"--vehicle": options.vehicle, "--start-from": options.start_from}
    chosen = "".join(f" {option} {shlex.quote(str(file))}" for option, file in files.items() if file)
    return f"swiftros train policy --seed {options.seed}{chosen}"


def _first_state(options: TrainingOptions, job: TrainingJob) -> Training:
    """Return the state to train from: the checkpoint in `job.out`, else a new one. Raises UsageError."""
    start = functools.partial(begin, job.world, job.settings)
    saved = job.out / "training.npz"
    if saved.exists():
        shapes = jax.eval_shape(start, options.seed)
        training = checkpoint.load(saved, shapes, fingerprint=job.fingerprint)
        done = trained_interactions(job.settings, training)
        print(f"resuming after {done / 1e6:.1f} M interactions", flush=True)
        return training
    training = jax.jit(start)(options.seed)
    if options.start_from:
        networks = checkpoint.load(options.start_from, training.networks, fingerprint=None)
        training = training._replace(networks=networks)
    return training


def train(job: TrainingJob, training: Training) -> dict:
    """Train to the last interaction and return the figures of the best trial.

    Raises:
        UsageError: the training was finished before.
    """
    settings = job.settings
    improve = compile_updates(job.world, settings, settings.updates_per_trial)
    best = best_so_far(job.out, trained_interactions(settings, training))
    started_s, first = time.monotonic(), trained_interactions(settings, training)
    while trained_interactions(settings, training) < settings.interactions:
        training, figures = jax.block_until_ready(improve(training))
        key = jax.random.fold_in(training.key, 1)
        difficulty = jnp.float32(schedule_at(settings, training.updates).difficulty)  # no second compilation
        result = trial.figures(job.race(training.networks["actor"], key, difficulty=difficulty), job.gates)
        done = trained_interactions(settings, training)
        speed = (done - first) / (time.monotonic() - started_s)
        result |= {"interactions": done, "steps_per_s": speed} | {name: float(v) for name, v in figures.items()}
        if best is None or merit(result) >= merit(best):
            best = result
            job.export(training.networks, result)
        with open(job.out / "progress.jsonl", "a") as file:
            file.write(json.dumps(result) + "\n")
        checkpoint.save(job.out / "training.npz", training, fingerprint=job.fingerprint)
        _print_progress(result, settings)
    if best is None:
        raise UsageError("this training was finished before; give a new --out or more interactions")
    return best


def _print_progress(result: dict, settings: PolicySettings) -> None:
    done, speed = result["interactions"], result["steps_per_s"]
    remaining = (settings.interactions - done) / speed
    learning = f"crashes {result['crashes_per_s']:.2f} /s  difficulty {result['difficulty']:.2f}"
    pace = f"{done / 1e6:6.1f} M  {speed:7.0f} steps/s"
    print(f"{pace}  {describe(result)}  {learning}  {remaining / 60:.0f} min left", flush=True)


def confirm(job: TrainingJob, networks: dict, seed: int) -> dict:
    """Return the figures of a policy in new races at full difficulty.

    The races by which it was selected overestimate it.
    """
    settings = job.settings
    key = jax.random.fold_in(jax.random.PRNGKey(seed), 1)
    keys = jax.random.split(key, settings.final_races // settings.trial_races)
    trials = [job.race(networks["actor"], key, difficulty=jnp.float32(1.0)) for key in keys]
    joined = jax.tree.map(lambda *parts: np.concatenate(parts), *trials)
    return trial.figures(joined, job.gates) | {"races": len(joined.end)}


def trained_interactions(settings: PolicySettings, training: Training) -> int:
    """Return the interactions trained so far."""
    return int(training.updates) * settings.batch


def merit(result: dict) -> tuple:
    """Return the sort key of policies, larger is better: difficulty first, then the merit of the trial."""
    return (result["difficulty"], *trial.merit(result))


def best_so_far(out: Path, interactions: int) -> dict | None:
    """Return the best trial in progress.jsonl up to `interactions`, None without one; remove later lines.

    An interruption between line and checkpoint leaves a later line; that trial is flown again.
    """
    path = out / "progress.jsonl"
    if not path.exists():
        return None
    rows = [json.loads(line) for line in path.read_text().splitlines()]
    rows = [row for row in rows if row["interactions"] <= interactions]
    path.write_text("".join(json.dumps(row) + "\n" for row in rows))
    return max(rows, key=merit, default=None)


def describe(result: dict) -> str:
    """Return the figures of a trial in one line."""
    return (
        f"finished {100 * result['finish_rate']:3.0f} %  lap {result['median_lap_s']:5.2f} s  "
        f"passages {result['passages']:4.1f}  margin {result['mean_margin_m']:.2f} m"
    )
