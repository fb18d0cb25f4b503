"""Sizes of effects together: Gauss and Newton's steps through `inject`, replay by replay."""

from dataclasses import replace

import numpy as np

from swift_ros.vehicle import Vehicle
from swift_sim_bridge.gap.attribution.evidence import Evidence
from swift_sim_bridge.gap.discovery import equation_search
from swift_sim_bridge.gap.effects.spec import Effect, inject, start
from swift_sim_bridge.gap.inference import null_distribution, stepwise
from swift_sim_bridge.gap.inference.sensitivity import (
    Linearisation,
    Sums,
    joined,
    linearise,
    slices,
    steps,
    sums_of,
    variants_of,
)
from swift_sim_bridge.gap.nominal import closed_loop
from swift_sim_bridge.gap.residuals.filters import apply

MADE_SHARE = 0.1  # of how far a parameter may be off, that the pipeline may make of it by itself
STEADY = 0.1  # of a standard error: the fit has settled
SETTLING = 12
DAMPED, LEAST_DAMPING = 10.0, 0.01  # times, after a step that overshot; share of what is known of each parameter
FLOOR = 0.02  # of a residual's variance, that its steps may differ by
RESTLESS = 0.3  # of the twins' variance, beyond which a recording's is no longer of its instruments alone
ANSWERED = 0.12  # and beyond which it matters to what was found in forces and moments: rotors answer a push
ROUGHER = 1.05  # times the twins' noise, from which on the recording's own counts


def sums_at(
    evidence: Evidence, vehicle: Vehicle, effects: tuple[Effect, ...], share: float = 1.0, central: bool = True
) -> Sums:
    """Return the sums of the whole seconds in the first `share` of all samples of each recording against a vehicle;
    central: see `variants_of`."""
    found = []
    lines = evidence.memory.lines(evidence.replayers, vehicle, effects, central)
    for line, sigma in zip(lines, evidence.sigmas, strict=True):
        sums = sums_of(line, sigma)
        kept = np.searchsorted(np.cumsum(sums.samples), share * sums.samples.sum(), "right") if share < 1 else None
        found.append(Sums(*(values[:kept] for values in vars(sums).values())))
    return joined(found)


def residuals_at(evidence: Evidence, vehicle: Vehicle) -> list[Linearisation]:
    """Return the recordings' residuals against a vehicle, without any footprint."""
    variants = variants_of(vehicle, ())
    return [linearise(replayer, variants) for replayer in evidence.replayers]


def settle(evidence: Evidence, vehicle: Vehicle, effects: list[Effect], values: dict, share: float = 1.0):
    """Return values and covariances by key of these effects together, on the first `share` of each recording.

    A step that explains less than the one before is damped (Levenberg and Marquardt): what a flight hardly determines,
    as how wide a draught is through which it passes once, moves last.
    """
    own, size = slices(tuple(effects)), steps(tuple(effects))
    low, high = (
        np.array([getattr(p, side) for effect in effects for p in effect.parameters]) for side in ("low", "high")
    )

    def named(row) -> dict:
        return {effect.key: row[own[effect.key]] for effect in effects}

    begun = np.concatenate([start(effect, vehicle) for effect in effects])
    tried = np.concatenate([values.get(effect.key, start(effect, vehicle)) for effect in effects])
    least, damping = np.inf, 0.0
    for _ in range(SETTLING):
        sums = sums_at(evidence, injected(vehicle, effects, named(tried)), tuple(effects), share)
        if sums.squares.sum() <= least:
            kept = _told(evidence, effects, sums, (low - begun) / size, (high - begun) / size)
            settled, known, least = tried, stepwise.of_told(sums, kept), sums.squares.sum()
            found, damping = stepwise.fit(known, np.arange(len(size))), damping / DAMPED
        else:
            damping = max(DAMPED * damping, LEAST_DAMPING)
        step = stepwise.step(known, damping, (low - settled) / size, (high - settled) / size)
        tried = settled + step * size
        if np.all(np.abs(step) <= STEADY * np.sqrt(np.diag(found.covariance))):
            settled = tried
            break
    covariance = within(found.covariance * np.outer(size, size), high - low)
    covariance[~kept, ~kept] = (high - low)[~kept] ** 2 / 12.0
    return named(settled), {effect.key: covariance[own[effect.key], own[effect.key]] for effect in effects}


def _told(evidence: Evidence, effects, sums: Sums, low, high) -> np.ndarray:
    """Return of which parameters (p,) the recordings tell anything that the pipeline does not make of it by itself: in
    a hover a gyro's own noise goes by its rates as a scale would. low, high (p,): how far they may be off, in steps."""
    seconds, made = np.count_nonzero(sums.samples), np.zeros(len(low))
    for key, own in slices(tuple(effects)).items():
        if key in evidence.nulls.slices:  # what is sought at a place, or blows by chance, twins were not searched for
            made[own] = np.abs(evidence.nulls.artefact[evidence.nulls.slices[key]]) * seconds
    reach = np.maximum(np.abs(low), np.abs(high))
    with np.errstate(invalid="ignore"):
        own_making = made > MADE_SHARE * reach * np.einsum("spp->p", sums.matrix)
    return stepwise.told(sums, low, high) & ~own_making


def within(covariance, reach) -> np.ndarray:
    """Return a covariance (p, p) with what is physical in it: a parameter lies somewhere in its reach (p,), infinite
    where nothing bounds it. A draught that is passed once may be near and weak or far and strong, not anything."""
    known = np.flatnonzero(np.isfinite(reach))
    both = covariance[np.ix_(known, known)] + np.diag(reach[known] ** 2 / 12.0)
    return covariance - covariance[:, known] @ np.linalg.solve(both, covariance[known])


def injected(vehicle: Vehicle, effects: list[Effect], values: dict) -> Vehicle:
    """Return the vehicle with these effects at their values."""
    for effect in effects:
        vehicle = inject(vehicle, effect, values[effect.key])
    return vehicle


def scene_at(evidence: Evidence, vehicle: Vehicle, effects, keys, values) -> stepwise.Scene:
    """Return what the selection sees: footprints at the vehicle with what was taken in, and to first order what would
    be left without that."""
    flown = injected(vehicle, [effects[key] for key in keys], values)
    all_effects = tuple(effects.values())
    whole = sums_at(evidence, flown, all_effects, central=False)  # as the twins' are: it helps choose, a fit measures
    own, size = slices(all_effects), steps(all_effects)
    for key in keys:
        rows = np.arange(own[key].start, own[key].stop)
        whole = stepwise.without(whole, rows, (values[key] - start(effects[key], vehicle)) / size[rows])
    begun = np.concatenate([start(one, vehicle) for one in all_effects])
    every = [p for one in all_effects for p in one.parameters]
    low = (np.array([p.least(at) for p, at in zip(every, begun, strict=True)]) - begun) / size
    high = (np.array([p.high for p in every]) - begun) / size
    kept = _told(evidence, all_effects, whole, low, high)
    whole, bare = (
        stepwise.of_told(one, kept)
        for one in (whole, null_distribution.without_artefact(whole, evidence.nulls.artefact))
    )
    return stepwise.Scene(bare, own, evidence.nulls, whole, low, high)


def pushed(evidence: Evidence, vehicle: Vehicle, least: float = RESTLESS) -> np.ndarray:
    """Return by how much (6,) m/s^2 and rad/s^2 chance pushes and turns a vehicle beyond its twins; zero where by less
    than a share of theirs, and by what its rotors are louder, as of a vehicle that carries a load.

    vehicle: with all that was taken in.
    """
    (line,), (replayer,), found = residuals_at(evidence, vehicle), evidence.replayers, np.zeros(6)
    noise = closed_loop.process_noise((len(replayer.recording.t),), replayer.recording.dt, 0)
    passed = np.var(np.diff(apply(replayer.filter.smooth, noise)))
    moving = null_distribution.unrest(line)
    for place, layer in ((0, "force"), (3, "moment")):
        rows = [i for i, channel in enumerate(replayer.channels) if channel.layer == layer]
        excess = np.maximum(moving - evidence.unrest[0], 0.0)[rows]
        allowed = (least + evidence.louder[0] - 1.0) * evidence.unrest[0][rows]
        found[place : place + len(rows)] = np.where(excess > allowed, np.sqrt(excess / passed), 0.0)
    return found


def as_rough(evidence: Evidence, vehicle: Vehicle, keys, values) -> Evidence:
    """Return the evidence with residuals that are as noisy as the recordings': the air, the rotors and the instruments
    may be rougher than those of the twins."""
    effects = {effect.key: effect for effect in evidence.effects}
    flown = injected(vehicle, [effects[key] for key in keys], values)
    lines, times = residuals_at(evidence, flown), []
    for line, noise, calm in zip(lines, evidence.noises, evidence.unrest, strict=True):
        floor = FLOOR * noise**2
        times.append(
            np.sqrt(np.maximum((null_distribution.unrest(line) + floor) / np.maximum(calm + floor, 1e-300), 1.0))
        )
    if all(np.all(one < ROUGHER) for one in times):
        return evidence
    sigmas = tuple(sigma * one for sigma, one in zip(evidence.sigmas, times, strict=True))
    return replace(
        evidence,
        sigmas=sigmas,
        nulls=null_distribution.rougher(evidence.nulls, times),
        library=equation_search.rougher(evidence.library, times),
    )
