"""Speed of the policy's training: interactions per second end to end, and the CPU time of its parts.

The settings are those of training.yaml, the first actor is the shipped pilot, randomisation is complete. Measured are
the vehicle file with all its physics, and the same vehicle with the paper's model; the latter also with the epochs and
minibatches of the prototype that preceded this trainer.
"""

import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from swift_ros import configuration
from swift_ros.camera.model import Camera
from swift_ros.errors import UsageError
from swift_ros.track import Track
from swift_ros.vehicle import Vehicle
from swift_sim_bridge.benchmarks import physics_speed
from swift_sim_bridge.flight_controller.rate_loop.stick_path import ReceiverFrame
from swift_sim_bridge.parallel import WHOLE, compile_for_devices, devices_for
from swift_sim_bridge.pilot import compiled, export, job, learner, ppo, trial
from swift_sim_bridge.pilot.episodes import environment, randomization
from swift_sim_bridge.pilot.episodes.world import World, make_world
from swift_sim_bridge.pilot.settings import Plan, PolicySettings, schedule_at
from swift_sim_bridge.simulation.simulator import FlightModel, advance

UPDATES = 8  # in the call that is timed end to end
ROUNDS = 5  # calls of which the fastest counts: other programs only add time
SEED = 0
PROTOTYPE = {"minibatch": 2048, "epochs": 4}  # beside 256 agents, 128 ticks; 133,000 interactions/s on one core


class Cost(NamedTuple):
    """What a call takes, s.

    Attributes:
        cpu_s, wall_s: of the fastest call.
        compile_s: CPU time of compiling it, little where the compiled code was kept from an earlier run.
    """

    cpu_s: float
    wall_s: float
    compile_s: float


class Bench(NamedTuple):
    """A training that is measured, before its first update."""

    world: World
    settings: PolicySettings
    plan: Plan
    training: learner.Training


def measure_call(function: Callable, *arguments, rounds: int = ROUNDS) -> Cost:
    """Return the cost of a function that is compiled at its first call."""
    begun_s = time.process_time()
    jax.block_until_ready(function(*arguments))
    first_s = time.process_time() - begun_s
    cpu_s, wall_s = [], []
    for _ in range(rounds):
        begun = time.process_time(), time.perf_counter()
        jax.block_until_ready(function(*arguments))
        cpu_s.append(time.process_time() - begun[0])
        wall_s.append(time.perf_counter() - begun[1])
    return Cost(min(cpu_s), min(wall_s), first_s - min(cpu_s))


def cases(folder: Path) -> dict[str, tuple[Vehicle, PolicySettings]]:
    """Return what is measured, by its name: vehicle and settings."""
    settings = job.read_settings(folder)
    if settings.ppo is None:
        raise UsageError(f"{folder / 'training.yaml'}: the speed of the training is that of 'algorithm: ppo'")
    full, paper = configuration.load(Vehicle, folder / "drone.yaml"), physics_speed.models(folder)[0].vehicle
    return {
        "full physics": (full, settings),
        "the paper's model": (paper, settings),
        "the same, prototype's epochs": (paper, replace(settings, ppo=replace(settings.ppo, **PROTOTYPE))),
    }


def begin(folder: Path, vehicle: Vehicle, settings: PolicySettings) -> Bench:
    """Return the training of a configuration folder with another vehicle and settings."""
    track, camera = configuration.load(Track, folder / "track.yaml"), configuration.load(Camera, folder / "camera.yaml")
    world = make_world(track, vehicle, camera, settings.environment, settings.estimate_errors)
    training = jax.jit(partial(learner.begin, world, settings))(SEED)
    actor = export.read_actor(folder / "models" / "pilot.onnx", training.networks["actor"])
    plan = Plan(settings.interactions, first_share=1.0)
    return Bench(world, settings, plan, learner.start_from(training, training.networks | {"actor": actor}))


def measure(folder: Path, progress=print) -> dict[str, Any]:
    """Return, by the name of the case: devices, interactions_per_s, cpu_s_per_million, compile_cpu_s, shares.

    `shares` are CPU s per million interactions by part; a part of another is subtracted from it.

    Args:
        folder: configuration folder.
        progress: called with lines of text.
    """
    result = {}
    for name, (vehicle, settings) in cases(folder).items():
        progress(f"training speed, {name}: compiling and measuring, a minute or two ...")
        bench = begin(folder, vehicle, settings)
        result[name] = _with_shares(_end_to_end(bench), _parts(bench))
    return result


def _end_to_end(bench: Bench) -> dict[str, float]:
    """Return the figures of a training with its trials, on all devices."""
    settings, training = bench.settings, bench.training
    updates = measure_call(compiled.compile_updates(bench.world, settings, bench.plan, UPDATES), training, rounds=3)
    races = trial.compile_races(bench.world, settings.trial_races)
    tried = measure_call(races, training.networks["actor"], training.key, jnp.float32(1.0), rounds=1)
    interactions = UPDATES * settings.batch
    trials = interactions / settings.trial_every
    return {
        "devices": devices_for(settings.agents, settings.minibatch),
        "interactions_per_s": interactions / (updates.wall_s + trials * tried.wall_s),
        "cpu_s_per_million": 1e6 * (updates.cpu_s + trials * tried.cpu_s) / interactions,
        "trials": 1e6 * tried.cpu_s / settings.trial_every,
        "compile_cpu_s": updates.compile_s + tried.compile_s,
    }


def _parts(bench: Bench) -> dict[str, float]:
    """Return the CPU time of parts of an update, each of which contains the one before, s per million interactions."""
    placed = (compiled.placement(),)
    functions = {"physics": _physics, "step": _steps, "roll_out": _roll_out}
    calls = {name: compile_for_devices(partial(part, bench), 1, placed, WHOLE) for name, part in functions.items()}
    return {name: 1e6 * measure_call(call, bench.training).cpu_s / bench.settings.batch for name, call in calls.items()}


def _with_shares(figures: dict, parts: dict) -> dict[str, Any]:
    """Return the figures with the shares of the parts in their CPU time."""
    steps = [parts["physics"], parts["step"] - parts["physics"], parts["roll_out"] - parts["step"]]
    rest = figures["cpu_s_per_million"] - figures["trials"] - parts["roll_out"]
    names = (
        "physics: rate loop, motors, battery, forces",
        "rules, rewards, estimate",
        "observations, networks, starts, noise",
        "advantages, gradients",
        "trial races",
    )
    return figures | {"shares": dict(zip(names, [*steps, rest, figures["trials"]], strict=True))}


def _physics(bench: Bench, training):
    """Fly the ticks of a roll-out at a constant command."""
    parameters = randomization.parameters_of(training.agents.episode, bench.world.parameters)
    n = training.agents.age.shape[0]
    frame = ReceiverFrame(jnp.ones((n, 3), jnp.float32), jnp.full((n,), 0.4, jnp.float32), jnp.ones((n,), bool))
    model = FlightModel(parameters, bench.world.profile)

    def tick(flight, _):
        return advance(flight, frame, model)[0], None

    return jax.lax.scan(tick, training.agents.flight, None, length=bench.settings.steps)[0]


def _steps(bench: Bench, training):
    """Fly the ticks of a roll-out at a constant action, with rules, rewards and errors of the estimate."""
    scales = schedule_at(bench.settings, bench.plan, training.updates).rewards
    action, still = jnp.zeros_like(training.agents.previous_action), jnp.zeros_like(training.agents.error)

    def tick(agents, _):
        moved, outcome = environment.step(bench.world, agents, action, still, scales)
        return moved, outcome._replace(terms={})

    return jax.lax.scan(tick, training.agents, None, length=bench.settings.steps)


def _roll_out(bench: Bench, training):
    return ppo.roll_out(bench.world, bench.settings, bench.plan, training, training.key)


def table(measured: dict[str, Any]) -> list[tuple[str, ...]]:
    """Return rows of text: a quantity, and its value in each case."""
    figures = list(measured.values())
    rows = [("training", *measured)]
    rows.append(("interactions/s, end to end", *(f"{one['interactions_per_s']:,.0f}" for one in figures)))
    rows.append(("devices", *(str(one["devices"]) for one in figures)))
    rows.append(("CPU s per million interactions", *(f"{one['cpu_s_per_million']:.2f}" for one in figures)))
    for name in figures[0]["shares"]:
        rows.append((f"  {name}", *(f"{one['shares'][name]:.2f}" for one in figures)))
    rows.append(("CPU s of compilation", *(f"{one['compile_cpu_s']:.1f}" for one in figures)))
    return rows
