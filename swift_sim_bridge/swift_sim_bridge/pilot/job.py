"""One training of the policy: what it reads, what it was before, and the state from which it goes on."""

import dataclasses
import functools
import shlex
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import jax

from swift_ros import configuration
from swift_ros.camera.model import Camera
from swift_ros.errors import UsageError
from swift_ros.plausibility.of_track import findings_with
from swift_ros.policy.observation import SIZE as OBSERVATION_SIZE
from swift_ros.race import limit
from swift_ros.track import Track
from swift_ros.trained_for.pilot import of_pilot
from swift_ros.vehicle import Vehicle
from swift_sim_bridge.model_files import checkpoint, provenance, sittings
from swift_sim_bridge.model_files.sittings import Sitting
from swift_sim_bridge.pilot import export, networks, trial
from swift_sim_bridge.pilot.episodes import rewards
from swift_sim_bridge.pilot.episodes.time_optimal import read_guide
from swift_sim_bridge.pilot.episodes.world import World, make_world
from swift_sim_bridge.pilot.learner import CRITIC_SIZE, Training, begin, start_from
from swift_sim_bridge.pilot.settings import Plan, PolicySettings
from swift_sim_bridge.simulation.checks import refuse_impossible

SHIPPED = "shipped"  # --start-from: the pilot of the repository or of the installation
CHECKPOINT = "training.npz"
# Conditions without which a training cannot go on: shapes of its arrays, the count of interactions, and what the trials
# compare. Everything else may change from sitting to sitting.
FIXED = ("seed", "start_from", "networks", "track", "vehicle", "agents", "steps", "environment.bank_size")


@dataclass(frozen=True)
class TrainingOptions:
    """What to train.

    Attributes:
        folder: configuration folder.
        out: folder of checkpoints, log and model.
        seed: of networks, races and noise.
        track, vehicle: files in place of the folder's; None: the folder's.
        interactions: length of the training; None: that of the settings.
        start_from: pilot.npz or pilot.onnx whose networks are the first, or SHIPPED; None: random networks.
        guide: folder of `swiftros limit` with the time-optimal lap; None: without.
        settings: file of what is other than in the folder's training.yaml, see `read_settings`; None: nothing.
    """

    folder: Path
    out: Path
    seed: int = 0
    track: Path | None = None
    vehicle: Path | None = None
    interactions: int | None = None
    start_from: str | None = None
    guide: Path | None = None
    settings: Path | None = None

    @property
    def files(self) -> tuple[Path, Path, Path]:
        """Files of vehicle, track and camera."""
        track, vehicle = self.track or self.folder / "track.yaml", self.vehicle or self.folder / "drone.yaml"
        return vehicle, track, self.folder / "camera.yaml"

    @property
    def first_networks(self) -> Path | None:
        """File of the first networks, None for random ones."""
        if self.start_from == SHIPPED:
            return configuration.shipped_folder() / "models" / "pilot.onnx"
        return Path(self.start_from) if self.start_from else None

    @property
    def command(self) -> str:
        """The command line that reproduces the training."""
        chosen = {"--track": self.track, "--vehicle": self.vehicle, "--interactions": self.interactions}
        chosen |= {"--start-from": self.start_from, "--guide": self.guide, "--settings": self.settings}
        words = "".join(f" {option} {shlex.quote(str(value))}" for option, value in chosen.items() if value is not None)
        return f"swiftros train policy --seed {self.seed}{words}"


@dataclass(frozen=True)
class TrainingJob:
    """What stays the same during one sitting of a training.

    Attributes:
        world: track, vehicle and settings as arrays.
        track: of the pictures.
        settings: of the algorithm.
        plan: schedules.
        out: folder of checkpoints, log and model.
        record: of the checkpoint: conditions, plan and sittings.
        race: (actor, key, difficulty) -> Trial, compiled.
        export: (networks, figures) writes the model.
        lap_limit_s: the time-optimal lap of track and vehicle as flown, s; None where it was not solved.
    """

    world: World
    track: Track
    settings: PolicySettings
    plan: Plan
    out: Path
    record: dict
    race: Callable
    export: Callable
    lap_limit_s: float | None = None

    @property
    def gates(self) -> int:
        """Number of gates of the track."""
        return len(self.track.gates)

    @property
    def starts_from_another(self) -> bool:
        """Whether the first networks were those of another training."""
        return bool(self.record["conditions"]["start_from"])

    @property
    def end(self) -> int:
        """Interactions at which the training is to end."""
        return self.record["sittings"][-1]["end"]


def read_settings(folder: Path, file: Path | None = None) -> PolicySettings:
    """Return section `policy` of training.yaml in a configuration folder, with what another file changes in it.

    Sections of the file change the entries that they have, but its `rewards` are all rewards. For another algorithm
    than PPO the `ppo` of training.yaml does not count. Raises UsageError.
    """
    shipped = folder / "training.yaml"
    settings = configuration.load_section(PolicySettings, shipped, "policy")
    if file is None:
        return settings
    content, changes = (configuration.read_section(one, "policy") for one in (shipped, file))
    if changes.get("algorithm", "ppo") != "ppo":
        content.pop("ppo", None)
    for name, entries in changes.items():
        is_part = isinstance(entries, dict) and isinstance(content.get(name), dict) and name != "rewards"
        content[name] = content[name] | entries if is_part else entries
    return configuration.build(PolicySettings, content, f"{file}, section 'policy'")


def prepare(options: TrainingOptions) -> TrainingJob:
    """Return the job of a new training, or of the next sitting of the one in `options.out`; make its folder.

    Raises:
        UsageError: bad input, or a checkpoint that cannot be continued with it.
    """
    settings = read_settings(options.folder, options.settings)
    vehicle, track, camera = (
        configuration.load(kind, file) for kind, file in zip((Vehicle, Track, Camera), options.files, strict=True)
    )
    refuse_impossible(vehicle)
    if found := findings_with(track, vehicle):
        raise UsageError(f"{options.files[1]}: {found[0].sentence}")
    started_from = _first_hash(options)
    require_guide(options, settings)
    guide = read_guide(options.guide, track, vehicle, settings.environment.bank_fixed) if options.guide else None
    world = make_world(track, vehicle, camera, settings.environment, settings.estimate_errors, guide)
    conditions = {"seed": options.seed, "start_from": started_from} | conditions_of(settings, vehicle, track, camera)
    saved = options.out / CHECKPOINT
    record = _resumed(options, settings, conditions) if saved.exists() else _first(options, settings, conditions)
    options.out.mkdir(parents=True, exist_ok=True)
    origin = provenance.Origin(
        command=options.command,
        configuration_sha256=provenance.configuration_hash(options.files, settings),
        seed=options.seed,
        trained_for=of_pilot(track, vehicle),
        sittings=record["sittings"],
        started_from=started_from,
    )
    known = limit.find(options.folder, track, vehicle)
    return TrainingJob(
        world=world,
        track=track,
        settings=settings,
        plan=Plan(**record["plan"]),
        out=options.out,
        record=record,
        race=trial.compile_races(world._replace(guide=None), settings.trial_races),
        export=functools.partial(export.write_pilot, options.out, origin=origin),
        lap_limit_s=known.as_flown.whole_lap_s if known else None,
    )


def require_guide(options: TrainingOptions, settings: PolicySettings) -> None:
    """Refuse rewards that are nothing without a guide, where there is none. Raises UsageError."""
    for name in rewards.NEED_GUIDE:
        if any(settings.rewards.get(name, ())) and not options.guide:
            raise UsageError(
                f"reward '{name}' of {options.settings or options.folder / 'training.yaml'} compares with the "
                "time-optimal lap; solve it with `swiftros limit`, and give its --out as --guide"
            )


def conditions_of(settings: PolicySettings, vehicle: Vehicle, track: Track, camera: Camera) -> dict:
    """Return what a training reads, without its length, which the sittings have."""
    shapes = {"observation": OBSERVATION_SIZE, "critic_observation": CRITIC_SIZE, "hidden": networks.WIDTH}
    files = {"vehicle": vehicle, "track": track, "camera": camera}
    chosen = configuration.content(settings)
    del chosen["interactions"], chosen["fine_tuning"]
    read = {name: configuration.content(record) for name, record in files.items()}
    for name in ("vehicle", "track"):
        del read[name]["name"]
    return {"networks": shapes} | read | chosen


def _first_hash(options: TrainingOptions) -> dict:
    """Return the SHA-256 of the first networks by their file's name, empty for random ones. Raises UsageError."""
    path = options.first_networks
    if path is None:
        return {}
    if not path.is_file():
        raise UsageError(
            f"--start-from names {path}, which does not exist; name a pilot.npz, a pilot.onnx, or {SHIPPED}"
        )
    return {path.name: provenance.file_hash(path)}


def _first(options: TrainingOptions, settings: PolicySettings, conditions: dict) -> dict:
    """Return the record of a new training."""
    shortened, end = settings.fine_tuning, options.interactions
    try:
        if options.start_from:
            end = end or shortened.interactions
            plan = Plan(end, shortened.critic_first, shortened.schedule_share)
        else:
            end = end or settings.interactions
            plan = Plan(end)
    except ValueError as error:
        raise UsageError(f"{error}; give more --interactions") from error
    first = dataclasses.asdict(Sitting(0, end))
    return {"interactions": 0, "conditions": conditions, "plan": dataclasses.asdict(plan), "sittings": [first]}


def _resumed(options: TrainingOptions, settings: PolicySettings, conditions: dict) -> dict:
    """Return the record of the training in `options.out` with one more sitting. Raises UsageError."""
    path = options.out / CHECKPOINT
    record = checkpoint.read_record(path)
    sittings.require_same(path, record["conditions"], conditions, FIXED)
    done = record["interactions"]
    end = options.interactions or (settings.fine_tuning if options.start_from else settings).interactions
    if end <= done:
        raise UsageError(
            f"the training in {options.out} has {done} interactions already; give more with --interactions, or "
            "another --out"
        )
    changes = sittings.changes(record["conditions"], conditions)
    print(f"resuming after {done / 1e6:.1f} M interactions", flush=True)
    for key, (before, now) in changes.items():
        print(f"changed: '{key}' from {before} to {now}", flush=True)
    if end > record["plan"]["schedule"]:
        print(f"prolonged: after {record['plan']['schedule'] / 1e6:.1f} M interactions all schedules stay at their end")
    more = dataclasses.asdict(Sitting(done, end, changes))
    return record | {"conditions": conditions, "sittings": [*record["sittings"], more]}


def first_state(job: TrainingJob, options: TrainingOptions) -> Training:
    """Return the state from which to train: the checkpoint in `job.out`, else a new one. Raises UsageError."""
    start = functools.partial(begin, job.world, job.settings)
    saved = job.out / CHECKPOINT
    if saved.exists():
        return checkpoint.load(saved, jax.eval_shape(start, options.seed))
    path = options.first_networks
    if path is None:
        return jax.jit(start)(options.seed)
    shapes = jax.eval_shape(start, options.seed).networks
    if path.suffix == ".onnx":  # has no critic: a random one
        given = {"actor": export.read_actor(path, shapes["actor"])}
    else:
        given = checkpoint.load(path, shapes)
    training = jax.jit(start)(options.seed)
    return start_from(training, training.networks | given)
