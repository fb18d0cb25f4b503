"""Trial races: the mean action, perturbed podium starts, the whole race with the normal rules."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from swift_sim_bridge.pilot import environment, networks, starts
from swift_sim_bridge.pilot.randomization import TICK

LONGEST_RACE = 3000  # ticks


class Trial(NamedTuple):
    """All (n, ...): passage_ticks (n, passages) ticks from the start (-1: never); margins (n, passages) m, hull to
    inner edge; end: position (n, 3) m where the race ended."""

    passage_ticks: jnp.ndarray
    margins: jnp.ndarray
    end: jnp.ndarray


def fly(world, actor, key, *, races: int, difficulty) -> Trial:
    """Return `races` races of the deterministic pilot from the podium; jit it with world and races bound."""
    bank = starts.first_bank(world)
    start_key, key = jax.random.split(key)
    agents = environment.reset(world, bank, start_key, races, difficulty, 1.0)
    rows = jnp.arange(races)

    def going(carry):
        tick, _, active, _, _ = carry
        return (tick < LONGEST_RACE) & jnp.any(active)

    def tick_on(carry):
        tick, agents, active, times, margins = carry
        seen, _ = environment.observations(world, agents)
        action = jnp.clip(networks.apply(actor, seen), -1.0, 1.0)
        moved, outcome = environment.step(world, agents, action, jax.random.fold_in(key, tick), {"progress": 0.0})
        passed = active & outcome.passed
        column = jnp.where(passed, agents.passages, world.passages)  # beyond the last: dropped
        times = times.at[rows, column].set(tick + 1, mode="drop")
        margins = margins.at[rows, column].set(outcome.margin, mode="drop")
        agents = starts.choose(active, moved, agents)
        active = active & ~outcome.done & (moved.passages < world.passages)
        return tick + 1, agents, active, times, margins

    times = jnp.full((races, world.passages), -1, jnp.int32)
    margins = jnp.full((races, world.passages), jnp.nan, jnp.float32)
    carry = (0, agents, jnp.ones((races,), bool), times, margins)
    _, agents, _, times, margins = jax.lax.while_loop(going, tick_on, carry)
    return Trial(times, margins, agents.flight.state.p_world)


def figures(trial: Trial, gates: int) -> dict:
    """Return finish_rate, median_lap_s and best_lap_s (flying laps, gate 1 to gate 1), median_race_s, passages (mean),
    min_margin_m and mean_margin_m; NaN where nothing was flown."""
    ticks = np.asarray(trial.passage_ticks)
    finished = ticks[:, -1] >= 0
    starts, ends = ticks[:, :-gates:gates], ticks[:, gates::gates]
    laps = (TICK * (ends - starts))[ends >= 0]
    race = TICK * ticks[finished, -1]
    margins = np.asarray(trial.margins)[ticks >= 0]

    def of(function, values):
        return float(function(values)) if values.size else float("nan")

    return {
        "finish_rate": float(np.mean(finished)),
        "median_lap_s": of(np.median, laps),
        "best_lap_s": of(np.min, laps),
        "median_race_s": of(np.median, race),
        "passages": float(np.mean(np.sum(ticks >= 0, axis=1))),
        "min_margin_m": of(np.min, margins),
        "mean_margin_m": of(np.mean, margins),
    }


def merit(result: dict) -> tuple[float, float, float]:
    """Return what pilots are compared by, larger is better: finish rate, then lap. Above 98 % a race more or less is
    luck of the draw, and the lap decides."""
    lap = result["median_lap_s"]
    return min(result["finish_rate"], 0.98), -lap if np.isfinite(lap) else -np.inf, result["passages"]
