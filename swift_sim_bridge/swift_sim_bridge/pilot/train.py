"""The training of the policy around its algorithm: trials, checkpoints, log, picture, export of the best policy.

One compiled call makes all updates between two trials. After each trial `training.npz` is saved, `progress.jsonl` gets
a line, `progress.png` is drawn anew, and a policy that is better than all before is exported. The same call resumes an
interrupted training, and prolongs a finished one where more interactions are given.
"""

import functools
import math
import time

import jax
import jax.numpy as jnp

from swift_sim_bridge.model_files import checkpoint, training_log
from swift_sim_bridge.parallel import InBackground
from swift_sim_bridge.pilot import picture, trial
from swift_sim_bridge.pilot.compiled import compile_updates
from swift_sim_bridge.pilot.job import CHECKPOINT, TrainingJob, TrainingOptions, first_state, prepare
from swift_sim_bridge.pilot.learner import Training
from swift_sim_bridge.pilot.settings import PolicySettings, schedule_at

LOG, PICTURE = "progress.jsonl", "progress.png"


def train_policy(options: TrainingOptions) -> None:
    """Train a policy, or go on with the training in `options.out`. Raises UsageError on bad input."""
    job = prepare(options)
    training = first_state(job, options)
    best = train(job, training)
    networks = checkpoint.load(options.out / "pilot.npz", training.networks)
    final = confirm(job, networks, options.seed)
    job.export(networks, best | {"final": final})
    print(f"best policy, in {final['races']} races that did not select it: {describe(final, job.lap_limit_s)}")
    print(f"it is {options.out / 'pilot.onnx'}; copy it and pilot.json to config/models to fly it")


def train(job: TrainingJob, training: Training) -> dict:
    """Train to the last interaction and return the figures of the best trial."""
    settings, first = job.settings, trained_interactions(job.settings, training)
    resumed = (job.out / CHECKPOINT).exists()  # without a checkpoint the log is of nothing that goes on
    rows = training_log.rows_until(job.out / LOG, "interactions", first if resumed else -1)
    for row in rows:  # a log of an earlier version does not say these
        row |= {"races": settings.trial_races, "mean_lap_s": row["median_lap_s"]} | row
    compiled = functools.cache(functools.partial(compile_updates, job.world, settings, job.plan))
    draw = InBackground(picture.draw)  # takes a second, in which the next updates begin
    compile_races = InBackground(job.race)
    if not rows and job.starts_from_another:
        draw(*_conclude(job, training, rows, {}))  # the pilot from which this training starts
    else:
        compile_races(*_before_a_trial(job, training))  # beside the first updates: compiling them keeps one core busy
    print(f"on {len(jax.devices())} {jax.default_backend()} devices", flush=True)
    started_s = time.monotonic()
    while (done := trained_interactions(settings, training)) < job.end:
        training, figures = jax.block_until_ready(compiled(updates_until_trial(job, done))(training))
        compile_races.wait()
        done = trained_interactions(settings, training)
        speed = (done - first) / (time.monotonic() - started_s)
        figures = {"steps_per_s": speed} | {name: float(value) for name, value in figures.items()}
        draw(*_conclude(job, training, rows, figures))
        checkpoint.save(job.out / CHECKPOINT, training, record=job.record | {"interactions": done})
        _print_progress(job, rows, speed)
    draw.wait()
    return best_of(rows)


def updates_until_trial(job: TrainingJob, done: int) -> int:
    """Return the number of updates until the next trial.

    Trials divide the training evenly, `trial_every` interactions apart at most. A prolonged training, whose evenly
    spaced trials end with the schedules, ends with a shorter interval.

    Args:
        job: the training.
        done: interactions so far.
    """
    settings = job.settings
    longest = max(1, settings.trial_every // settings.batch)
    if done >= job.plan.schedule:
        return min(longest, math.ceil((job.end - done) / settings.batch))
    updates = math.ceil(job.plan.schedule / settings.batch)
    return math.ceil(updates / math.ceil(updates / longest))


def _conclude(job: TrainingJob, training: Training, rows: list[dict], figures: dict) -> tuple:
    """Fly a trial, add its row to the log, and export the policy if it is the best so far; return what to draw.

    A policy that would be the best flies a second trial, and both together decide: one alone may be luck.
    """
    actor, key, difficulty = _before_a_trial(job, training)
    races, best = job.race(actor, key, difficulty), max(map(merit, rows), default=())
    done = {"interactions": trained_interactions(job.settings, training), "difficulty": float(difficulty)}
    result = trial.figures(races, job.gates) | {"trials": 1} | done | figures
    if is_best := merit(result) >= best:
        again = job.race(actor, jax.random.fold_in(key, 1), difficulty)
        result |= trial.figures(trial.joined([races, again]), job.gates) | {"races": result["races"], "trials": 2}
        is_best = merit(result) >= best
    if is_best:
        job.export(training.networks, result)
    rows.append(result)
    training_log.append(job.out / LOG, result)
    return job.out / PICTURE, list(rows), races, job.track, job.world.guide


def _before_a_trial(job: TrainingJob, training: Training) -> tuple:
    """Return actor, key and difficulty of a trial."""
    training = jax.device_get(training)  # the races may be split over another number of devices
    difficulty = jnp.float32(schedule_at(job.settings, job.plan, training.updates).difficulty)  # no second compilation
    return training.networks["actor"], jax.random.fold_in(training.key, 1), difficulty


def _print_progress(job: TrainingJob, rows: list[dict], speed: float) -> None:
    """Print a line on the last trial, the remaining time and the best trial so far."""
    last, best = rows[-1], best_of(rows)
    remaining_min = max(job.end - last["interactions"], 0) / speed / 60
    lost = f"  updates lost {100 * last['lost_updates']:.0f} %" if last.get("lost_updates") else ""
    print(
        f"{last['interactions'] / 1e6:.1f} of {job.end / 1e6:.1f} M  {speed:.0f} interactions/s  "
        f"{remaining_min:.0f} min left  {describe(last, job.lap_limit_s)}  crashes {last['crashes_per_s']:.2f} /s  "
        f"difficulty {last['difficulty']:.2f}  best: {100 * best['finish_rate']:.0f} % in {best['median_lap_s']:.2f} s "
        f"at {best['interactions'] / 1e6:.1f} M{lost}"
    )
    terms = {name: last[f"{name}_reward_per_s"] for name in job.settings.rewards}
    text = ", ".join(f"{name} {terms[name]:+.3g}" for name in sorted(terms, key=lambda name: -abs(terms[name])))
    print(f"    reward {last['reward_per_s']:.2f} /s: {text}", flush=True)


def confirm(job: TrainingJob, networks: dict, seed: int) -> dict:
    """Return the figures of a policy in new races at full difficulty.

    The races by which it was selected overestimate it.
    """
    settings = job.settings
    key = jax.random.fold_in(jax.random.PRNGKey(seed), 1)
    keys = jax.random.split(key, max(1, settings.final_races // settings.trial_races))
    trials = [job.race(networks["actor"], key, jnp.float32(1.0)) for key in keys]
    return trial.figures(trial.joined(trials), job.gates)


def trained_interactions(settings: PolicySettings, training: Training) -> int:
    """Return the interactions trained so far."""
    return int(training.updates) * settings.batch


def merit(result: dict) -> tuple:
    """Return the sort key of policies, larger is better: difficulty first, then the merit of the trial."""
    return (result["difficulty"], *trial.merit(result))


def best_of(rows: list[dict]) -> dict:
    """Return the best trial; of equal ones the last, whose policy is the one that was exported."""
    return max(reversed(rows), key=merit)


def describe(result: dict, lap_limit_s: float | None) -> str:
    """Return the figures of a trial in one line, its lap as a multiple of the limit where one is known, s."""
    ratio = f" ({result['median_lap_s'] / lap_limit_s:.3f} times the limit)" if lap_limit_s else ""
    return (
        f"finished {100 * result['finish_rate']:3.0f} %  lap {result['median_lap_s']:5.2f} s{ratio}  "
        f"passages {result['passages']:4.1f}  margin {result['mean_margin_m']:.2f} m"
    )
