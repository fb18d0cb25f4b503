"""`swiftros train policy`: proximal policy optimisation of the pilot, to be read from top to bottom.

Settings, then one update (fly, judge advantages, descend), then the training around it with trial races, checkpoints
and the export of the best pilot so far. One jitted call makes all the updates between two trials.
"""

import dataclasses
import functools
import json
import shlex
import time
from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax

from swift_ros import configuration
from swift_ros.camera.model import Camera
from swift_ros.errors import UsageError
from swift_ros.policy.observation import SIZE as OBSERVATION_SIZE
from swift_ros.track import Track
from swift_ros.vehicle import Vehicle
from swift_sim_bridge.model_files import checkpoint, provenance
from swift_sim_bridge.pilot import environment as race_env
from swift_sim_bridge.pilot import export, networks, rewards, starts, trial
from swift_sim_bridge.pilot.randomization import TICK
from swift_sim_bridge.pilot.world import EnvironmentSettings, make_world

CRITIC_SIZE = OBSERVATION_SIZE + 27
SMALLEST_LEARNING_RATE = 2e-5


@dataclasses.dataclass(frozen=True)
class PolicySettings:
    """Section `policy` of config/training.yaml, which says what each key means. A pair is a schedule: its value at
    the first and at the last interaction."""

    interactions: int
    agents: int
    steps: int
    minibatch: int
    epochs: int
    clip: float
    discount: float
    gae: tuple[float, float]
    sigma: tuple[float, float]
    learning_rate: tuple[float, float]
    kl_target: float
    gradient_norm: float
    reward_scale: float
    difficulty_from: int
    difficulty_full: int
    trial_every: int
    trial_races: int
    final_races: int
    rewards: dict[str, tuple[float, float]]
    environment: EnvironmentSettings

    def __post_init__(self):
        unknown = set(self.rewards) - set(rewards.TERMS)
        if unknown:
            raise ValueError(f"unknown reward '{min(unknown)}'; known are {', '.join(rewards.TERMS)}")
        if self.batch % self.minibatch:
            raise ValueError("'minibatch' must divide agents x steps")

    @property
    def batch(self) -> int:
        return self.agents * self.steps

    @property
    def updates_per_trial(self) -> int:
        return max(1, self.trial_every // self.batch)


class Training(NamedTuple):
    """All that changes: networks, Adam's state, races, bank of gate states, key, updates done, learning rate."""

    networks: dict
    optimizer: optax.OptState
    agents: race_env.Agents
    bank: jnp.ndarray
    key: jnp.ndarray
    updates: jnp.ndarray
    learning_rate: jnp.ndarray


class Batch(NamedTuple):
    """One rollout, leading (steps, agents)."""

    observation: jnp.ndarray
    critic_observation: jnp.ndarray
    raw: jnp.ndarray
    noise: jnp.ndarray
    outcome: race_env.Outcome


class Schedule(NamedTuple):
    """The scheduled values of one update."""

    sigma: jnp.ndarray
    gae: jnp.ndarray
    learning_rate_cap: jnp.ndarray
    difficulty: jnp.ndarray
    rewards: dict


def schedule_at(settings: PolicySettings, updates) -> Schedule:
    """Return the schedule after `updates` updates: sigma and learning rate geometric, the rest linear."""
    interactions = updates * float(settings.batch)
    share = jnp.clip(interactions / settings.interactions, 0.0, 1.0)

    def linear(pair):
        return pair[0] + share * (pair[1] - pair[0])

    def geometric(pair):
        return pair[0] * (pair[1] / pair[0]) ** share

    ramp = (interactions - settings.difficulty_from) / max(settings.difficulty_full - settings.difficulty_from, 1)
    return Schedule(
        geometric(settings.sigma),
        linear(settings.gae),
        geometric(settings.learning_rate),
        jnp.clip(ramp, 0.0, 1.0),
        {name: linear(pair) for name, pair in settings.rewards.items()},
    )


def optimizer_of(settings: PolicySettings):
    return optax.chain(optax.clip_by_global_norm(settings.gradient_norm), optax.scale_by_adam(eps=1e-5))


def begin(world, settings: PolicySettings, seed) -> Training:
    """Return the training before its first update."""
    key, network_key, reset_key, age_key = jax.random.split(jax.random.PRNGKey(seed), 4)
    parameters = networks.make_actor_and_critic(network_key, OBSERVATION_SIZE, CRITIC_SIZE)
    bank = starts.first_bank(world)
    agents = race_env.reset(world, bank, reset_key, settings.agents, jnp.float32(0.0), 1.0)
    # Episodes that all start now would all end together.
    longest = int(settings.environment.episode_s / TICK)
    agents = agents._replace(age=jax.random.randint(age_key, (settings.agents,), 0, longest))
    return Training(
        parameters,
        optimizer_of(settings).init(parameters),
        agents,
        bank,
        key,
        jnp.int32(0),
        jnp.float32(settings.learning_rate[0]),
    )


def roll_out(world, settings: PolicySettings, training: Training, schedule: Schedule, key):
    """Return (agents, bank, batch): `steps` ticks of all agents under the noisy policy, finished ones reset."""
    actor = training.networks["actor"]

    def tick(carry, key):
        agents, bank = carry
        noise_key, step_key, bank_key, reset_key = jax.random.split(key, 4)
        seen, critic_seen = race_env.observations(world, agents)
        noise = jax.random.normal(noise_key, (settings.agents, 4))
        raw = networks.apply(actor, seen) + schedule.sigma * noise
        moved, outcome = race_env.step(world, agents, jnp.clip(raw, -1.0, 1.0), step_key, schedule.rewards)
        straight = settings.environment.bank_straight
        moved, bank = race_env.commit(moved, bank, agents.gate, outcome.passed, bank_key, straight)
        share = settings.environment.podium_share
        fresh = race_env.reset(world, bank, reset_key, settings.agents, schedule.difficulty, share)
        agents = starts.choose(outcome.done | outcome.timeout, fresh, moved)
        return (agents, bank), Batch(seen, critic_seen, raw, noise, outcome)

    carry = (training.agents, training.bank)
    (agents, bank), batch = jax.lax.scan(tick, carry, jax.random.split(key, settings.steps))
    return agents, bank, batch


def advantages(settings: PolicySettings, outcome: race_env.Outcome, values, last_value, gae):
    """Return generalised advantages (steps, agents) of values (steps, agents), last_value (agents,).

    An episode that only ran out of time is continued by the value of its last observation.
    """
    ended = outcome.done | outcome.timeout
    reward = settings.reward_scale * outcome.reward + settings.discount * values * outcome.timeout

    def back(carry, row):
        advantage, next_value = carry
        reward, value, ended = row
        goes_on = settings.discount * (1.0 - ended)
        advantage = reward + goes_on * next_value - value + goes_on * gae * advantage
        return (advantage, value), advantage

    _, result = jax.lax.scan(back, (jnp.zeros_like(last_value), last_value), (reward, values, ended), reverse=True)
    return result


def loss(parameters, rows, sigma, clip: float):
    """Return (loss, Kullback-Leibler divergence estimate) of PPO on rows of a batch."""
    observation, critic_observation, raw, noise, advantage, target = rows
    mean = networks.apply(parameters["actor"], observation)
    log_ratio = 0.5 * jnp.sum(noise**2 - ((raw - mean) / sigma) ** 2, axis=-1)
    ratio = jnp.exp(log_ratio)
    advantage = (advantage - jnp.mean(advantage)) / (jnp.std(advantage) + 1e-8)
    gain = jnp.minimum(ratio * advantage, jnp.clip(ratio, 1 - clip, 1 + clip) * advantage)
    value = networks.apply(parameters["critic"], critic_observation)[:, 0]
    return jnp.mean(0.5 * (value - target) ** 2 - gain), jnp.mean(ratio - 1.0 - log_ratio)


def descend(settings: PolicySettings, training: Training, rows, sigma, learning_rate, key):
    """Return (networks, optimizer state, KL of the last epoch) after `epochs` passes over shuffled minibatches."""
    optimizer = optimizer_of(settings)

    def minibatch(carry, index):
        parameters, state = carry
        part = tuple(row[index] for row in rows)
        (_, divergence), gradient = jax.value_and_grad(loss, has_aux=True)(parameters, part, sigma, settings.clip)
        step, state = optimizer.update(gradient, state)
        parameters = jax.tree.map(lambda p, s: p - learning_rate * s, parameters, step)
        return (parameters, state), divergence

    def epoch(carry, key):
        order = jax.random.permutation(key, settings.batch).reshape(-1, settings.minibatch)
        return jax.lax.scan(minibatch, carry, order)

    carry = (training.networks, training.optimizer)
    (parameters, state), divergence = jax.lax.scan(epoch, carry, jax.random.split(key, settings.epochs))
    return parameters, state, jnp.mean(divergence[-1])


def update(world, settings: PolicySettings, training: Training):
    """Return (training after one update, figures of it)."""
    key, fly_key, learn_key = jax.random.split(training.key, 3)
    schedule = schedule_at(settings, training.updates)
    agents, bank, batch = roll_out(world, settings, training, schedule, fly_key)
    _, last_seen = race_env.observations(world, agents)
    critic = training.networks["critic"]
    values = networks.apply(critic, batch.critic_observation)[..., 0]
    last_value = networks.apply(critic, last_seen)[..., 0]
    advantage = advantages(settings, batch.outcome, values, last_value, schedule.gae)
    rows = (batch.observation, batch.critic_observation, batch.raw, batch.noise, advantage, advantage + values)
    rows = tuple(row.reshape(settings.batch, *row.shape[2:]) for row in rows)
    learning_rate = jnp.minimum(training.learning_rate, schedule.learning_rate_cap)
    parameters, state, divergence = descend(settings, training, rows, schedule.sigma, learning_rate, learn_key)
    strides = divergence / settings.kl_target
    factor = jnp.where(strides > 1.5, 1 / 1.2, jnp.where(strides < 1 / 1.5, 1.2, 1.0))
    learning_rate = jnp.maximum(factor * learning_rate, SMALLEST_LEARNING_RATE)
    seconds = settings.batch * TICK
    figures = {
        "crashes_per_s": jnp.sum(batch.outcome.crashed) / seconds,
        "misses_per_s": jnp.sum(batch.outcome.missed) / seconds,
        "passages_per_s": jnp.sum(batch.outcome.passed) / seconds,
        "reward_per_s": jnp.sum(batch.outcome.reward) / seconds,
        "kl": divergence,
        "learning_rate": learning_rate,
        "sigma": schedule.sigma,
        "difficulty": schedule.difficulty,
        "explained": 1 - jnp.var(advantage) / jnp.var(advantage + values),
    }
    return Training(parameters, state, agents, bank, key, training.updates + 1, learning_rate), figures


def compile_updates(world, settings: PolicySettings, count: int):
    """Return the jitted function: training -> (training after `count` updates, their mean figures)."""

    def improve(training):
        training, figures = jax.lax.scan(lambda t, _: update(world, settings, t), training, None, length=count)
        return training, jax.tree.map(jnp.mean, figures)

    return jax.jit(improve)


def read_settings(folder: Path) -> PolicySettings:
    """Return section `policy` of training.yaml in a configuration folder. Raises UsageError."""
    return configuration.load_section(PolicySettings, folder / "training.yaml", "policy")


def world_files(folder: Path, vehicle: Path | None = None) -> tuple[Path, Path, Path]:
    """Return the files of vehicle, track and camera in a configuration folder; vehicle: in the place of its own."""
    return vehicle or folder / "drone.yaml", folder / "track.yaml", folder / "camera.yaml"


def read_world(files: tuple[Path, Path, Path], settings: PolicySettings):
    """Return the training's world from the files of vehicle, track and camera. Raises UsageError."""
    vehicle, track, camera = (
        configuration.load(kind, file) for kind, file in zip((Vehicle, Track, Camera), files, strict=True)
    )
    return make_world(track, vehicle, camera, settings.environment)


def trained_interactions(settings: PolicySettings, training: Training) -> int:
    return int(training.updates) * settings.batch


def add_arguments(parser) -> None:
    """Add the options of `swiftros train policy`."""
    parser.add_argument("--out", type=Path, default=Path("runs/policy"), help="folder of checkpoints and the model")
    parser.add_argument("--seed", type=int, default=0, help="of networks, races and noise (default 0)")
    parser.add_argument("--config", help="configuration folder")
    parser.add_argument("--vehicle", type=Path, metavar="FILE", help="another drone.yaml, as `gap` repairs one")
    parser.add_argument("--start-from", type=Path, help="another training's best.npz to start from")


def run(arguments) -> int:
    """Train, or go on where the folder `--out` stands; return 0. Raises UsageError on bad input."""
    folder = configuration.configuration_folder(arguments.config)
    print(f"configuration: {folder}", flush=True)
    settings = read_settings(folder)
    files = world_files(folder, arguments.vehicle)
    world = read_world(files, settings)
    if arguments.start_from and not arguments.start_from.is_file():
        raise UsageError(f"--start-from names {arguments.start_from}, which does not exist; name a best.npz")
    arguments.out.mkdir(parents=True, exist_ok=True)
    configuration_sha256 = provenance.configuration_hash(files, settings)
    source = provenance.file_hash(arguments.start_from) if arguments.start_from else ""
    fingerprint = f"{configuration_sha256} {arguments.seed} {source}"
    training = jax.jit(functools.partial(begin, world, settings))(arguments.seed)
    saved = arguments.out / "training.npz"
    if saved.exists():
        training = checkpoint.load(saved, training, fingerprint=fingerprint)
        print(f"going on after {trained_interactions(settings, training) / 1e6:.1f} M interactions", flush=True)
    elif arguments.start_from:
        best = checkpoint.load(arguments.start_from, training.networks, fingerprint=None)
        training = training._replace(networks=best)
    options = {"--vehicle": arguments.vehicle, "--start-from": arguments.start_from}
    chosen = "".join(f" {option} {shlex.quote(str(file))}" for option, file in options.items() if file)
    command = f"swiftros train policy --seed {arguments.seed}{chosen}"
    record = functools.partial(
        export.write_pilot, arguments.out, command=command, configuration=configuration_sha256, seed=arguments.seed
    )
    race = jax.jit(functools.partial(trial.fly, world, races=settings.trial_races))
    best = train(world, settings, training, race, arguments.out, fingerprint, record)
    networks_of_best = checkpoint.load(arguments.out / "best.npz", training.networks, fingerprint=None)
    final = confirm(settings, race, networks_of_best, arguments.seed, len(world.gates.yaws))
    record(networks_of_best, best | {"final": final})
    print(f"best pilot, in {settings.final_races} races that did not choose it: {describe(final)}")
    print(f"it is {arguments.out / 'pilot.onnx'}; copy it and pilot.json to config/models to fly it")
    return 0


def confirm(settings: PolicySettings, race, parameters: dict, seed: int, gates: int) -> dict:
    """Return the figures of a pilot in fresh races at full difficulty: those that chose it flatter it."""
    key = jax.random.fold_in(jax.random.PRNGKey(seed), 1)
    keys = jax.random.split(key, settings.final_races // settings.trial_races)
    trials = [race(parameters["actor"], key, difficulty=jnp.float32(1.0)) for key in keys]
    whole = jax.tree.map(lambda *parts: np.concatenate(parts), *trials)
    return trial.figures(whole, gates) | {"races": len(whole.end)}


def train(world, settings: PolicySettings, training: Training, race, out: Path, fingerprint: str, record) -> dict:
    """Train to the last interaction; return the figures of the best trial.

    race(actor, key, difficulty=...) flies a Trial. After every trial `training.npz` is saved, `progress.jsonl` gets a
    line, and `record(networks, figures)` is called for a pilot better than all before.
    """
    gates = len(world.gates.yaws)
    improve = compile_updates(world, settings, settings.updates_per_trial)
    best = best_so_far(out, trained_interactions(settings, training))
    started, first = time.monotonic(), trained_interactions(settings, training)
    while trained_interactions(settings, training) < settings.interactions:
        training, figures = jax.block_until_ready(improve(training))
        key = jax.random.fold_in(training.key, 1)
        difficulty = schedule_at(settings, training.updates).difficulty
        result = trial.figures(race(training.networks["actor"], key, difficulty=difficulty), gates)
        done = trained_interactions(settings, training)
        speed = (done - first) / (time.monotonic() - started)
        result |= {"interactions": done, "steps_per_s": speed} | {name: float(v) for name, v in figures.items()}
        if best is None or merit(result) >= merit(best):
            best = result
            record(training.networks, result)
        with open(out / "progress.jsonl", "a") as file:
            file.write(json.dumps(result) + "\n")
        checkpoint.save(out / "training.npz", training, fingerprint=fingerprint)
        remaining = (settings.interactions - done) / speed
        learning = f"crashes {result['crashes_per_s']:.2f} /s  difficulty {result['difficulty']:.2f}"
        pace = f"{done / 1e6:6.1f} M  {speed:7.0f} steps/s"
        print(f"{pace}  {describe(result)}  {learning}  {remaining / 60:.0f} min left", flush=True)
    if best is None:
        raise UsageError("this training was finished before; give a new --out or more interactions")
    return best


def merit(result: dict) -> tuple:
    """Return what pilots are compared by: full difficulty before ease, then the trial's merit."""
    return (result["difficulty"], *trial.merit(result))


def best_so_far(out: Path, interactions: int) -> dict | None:
    """Return the best trial up to `interactions` that progress.jsonl tells of, and forget those after it: an
    interruption between line and checkpoint flies them again."""
    path = out / "progress.jsonl"
    if not path.exists():
        return None
    rows = [json.loads(line) for line in path.read_text().splitlines()]
    rows = [row for row in rows if row["interactions"] <= interactions]
    path.write_text("".join(json.dumps(row) + "\n" for row in rows))
    return max(rows, key=merit, default=None)


def describe(result: dict) -> str:
    return (
        f"finished {100 * result['finish_rate']:3.0f} %  lap {result['median_lap_s']:5.2f} s  "
        f"passages {result['passages']:4.1f}  margin {result['mean_margin_m']:.2f} m"
    )
