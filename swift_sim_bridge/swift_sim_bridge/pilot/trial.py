"""Trial races: whole races of the deterministic policy, from random starts on the podium."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from swift_sim_bridge.parallel import DEVICES, SPLIT, WHOLE, compile_for_devices, devices_for
from swift_sim_bridge.pilot import networks
from swift_sim_bridge.pilot.episodes import environment, randomization, starts
from swift_sim_bridge.pilot.episodes.randomization import TICK, UNDISTURBED, Disturbance

MAX_RACE_TICKS = 3000  # 30 s; a longer race counts as not finished. Races of the shipped policy take 18 s
FAILURES_OF_CHANCE = 2  # failed races by which trials differ by chance; with fewer the lap time alone decides
FAILURE_COST = 3.0  # further ones in a hundred are as bad as laps longer by so many per cent
LAST_COMMANDS = 7  # that are kept: 60 ms of delay, more than a training has
LINES = 8  # races of a trial whose lines are kept, for the picture


class Trial(NamedTuple):
    """What n races ended in, and the lines of the first `LINES` of each device.

    Attributes:
        passage_ticks: (n, passages), ticks from the start; -1 where a gate was not passed.
        margins: (n, passages) m, hull to inner edge; NaN where a gate was not passed.
        end: (n, 3) m, position where the race ended.
        lines: (k, ticks, 3) m, positions; NaN after the end.
        thrusts: (k, ticks) N, static thrust of all rotors of the vehicle file at their speeds, along the lines.
    """

    passage_ticks: jnp.ndarray
    margins: jnp.ndarray
    end: jnp.ndarray
    lines: jnp.ndarray
    thrusts: jnp.ndarray


def fly(world, actor, key, *, races: int, difficulty, by: Disturbance = UNDISTURBED) -> Trial:
    """Return the Trial of `races` races from the podium, with what differs from a training."""
    bank = starts.first_bank(world)
    start_key, key = jax.random.split(key)
    innovations = jax.random.normal(key, (MAX_RACE_TICKS, races, randomization.ERRORS))  # one draw: see `roll_out`
    conditions = environment.Conditions(difficulty, commands=LAST_COMMANDS, by=by)
    agents = environment.reset(world, bank, start_key, races, conditions)
    rows, kept = jnp.arange(races), min(LINES, races)

    def continues(carry):
        tick, _, active, *_ = carry
        return (tick < MAX_RACE_TICKS) & jnp.any(active)

    def fly_tick(carry):
        tick, agents, active, times, margins, shown = carry
        observation, _ = environment.observations(world, agents)
        action = jnp.clip(networks.apply(actor, observation), -1.0, 1.0)
        moved, outcome = environment.step(world, agents, action, innovations[tick], {"progress": 0.0})
        passed = active & outcome.passed
        column = jnp.where(passed, agents.passages, world.passages)  # beyond the last column: not stored
        times = times.at[rows, column].set(tick + 1, mode="drop")
        margins = margins.at[rows, column].set(outcome.margin, mode="drop")
        agents = starts.choose(active, moved, agents)
        state = moved.flight.state
        thrust = jnp.sum(world.parameters.rotors.thrust_coefficient * state.rotor_speed[:kept] ** 2, axis=-1)
        now = jnp.concatenate([state.p_world[:kept], thrust[:, None]], axis=-1)
        shown = shown.at[:, tick].set(jnp.where(active[:kept, None], now, jnp.nan))
        active = active & ~outcome.done & (moved.passages < world.passages)
        return tick + 1, agents, active, times, margins, shown

    times = jnp.full((races, world.passages), -1, jnp.int32)
    margins = jnp.full((races, world.passages), jnp.nan, jnp.float32)
    shown = jnp.full((kept, MAX_RACE_TICKS, 4), jnp.nan, jnp.float32)  # position and thrust
    carry = (0, agents, jnp.ones((races,), bool), times, margins, shown)
    _, agents, _, times, margins, shown = jax.lax.while_loop(continues, fly_tick, carry)
    return Trial(times, margins, agents.flight.state.p_world, shown[..., :3], shown[..., 3])


def compile_races(world, races: int):
    """Return the compiled function: actor, key, difficulty and a `Disturbance` -> Trial of `races` races."""
    devices = devices_for(races)

    def fly_share(actor, key, difficulty, by):
        own_key = jax.random.fold_in(key, jax.lax.axis_index(DEVICES))
        return fly(world, actor, own_key, races=races // devices, difficulty=difficulty, by=by)

    compiled = compile_for_devices(fly_share, devices, (WHOLE, WHOLE, WHOLE, WHOLE), SPLIT)
    return lambda actor, key, difficulty, by=UNDISTURBED: compiled(actor, key, difficulty, by)


def joined(trials: list[Trial]) -> Trial:
    """Return trials as one."""
    return jax.tree.map(lambda *parts: np.concatenate(parts), *trials)


def figures(trial: Trial, gates: int) -> dict:
    """Return the figures of a trial.

    Args:
        trial: the races.
        gates: number of gates of the track.

    Returns:
        races, finish_rate, median_lap_s, mean_lap_s and best_lap_s (flying laps, gate 1 to gate 1), median_race_s,
        passages (mean), min_margin_m and mean_margin_m; NaN where there is no lap, race or passage.
    """
    ticks = np.asarray(trial.passage_ticks)
    finished = ticks[:, -1] >= 0
    starts, ends = ticks[:, :-gates:gates], ticks[:, gates::gates]
    laps = (TICK * (ends - starts))[ends >= 0]
    race = TICK * ticks[finished, -1]
    margins = np.asarray(trial.margins)[ticks >= 0]

    def reduced(function, values):
        return float(function(values)) if values.size else float("nan")

    return {
        "races": len(ticks),
        "finish_rate": float(np.mean(finished)),
        "median_lap_s": reduced(np.median, laps),
        "mean_lap_s": reduced(np.mean, laps),
        "best_lap_s": reduced(np.min, laps),
        "median_race_s": reduced(np.median, race),
        "passages": float(np.mean(np.sum(ticks >= 0, axis=1))),
        "min_margin_m": reduced(np.min, margins),
        "mean_margin_m": reduced(np.mean, margins),
    }


def merit(result: dict) -> tuple[float, float, float]:
    """Return the sort key of policies, larger is better: the mean lap, made longer by failed races.

    A key of the finish rate first would keep a slow pilot that always finishes in place of one a tenth faster that
    finishes 97 %. The median of laps is known to a tick only. Of policies without a lap, the one with most passages is
    the best.
    """
    lap, failures = result["mean_lap_s"], 1.0 - result["finish_rate"] - FAILURES_OF_CHANCE / result["races"]
    cost_s = lap * (1.0 + FAILURE_COST * max(failures, 0.0))
    return -cost_s if np.isfinite(lap) else -np.inf, result["finish_rate"], result["passages"]
