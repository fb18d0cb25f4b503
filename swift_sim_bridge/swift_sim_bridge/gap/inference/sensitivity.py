"""What each effect would do to every residual, and all that least squares needs of it: sums over seconds of flight."""

from dataclasses import dataclass
from functools import partial

import numpy as np

from swift_ros.vehicle import Vehicle
from swift_sim_bridge.effects import Effect
from swift_sim_bridge.gap.effects.injection import file_values, idle_terms, inject
from swift_sim_bridge.gap.effects.patch import with_idle_terms
from swift_sim_bridge.gap.residuals.residual_model import ResidualModel, Variants
from swift_sim_bridge.parallel import run_in_threads

CHANGES = {"motor": "motor", "imu": "imu", "vio": "imu", "camera": "camera", "command": "command"}  # by layer


@dataclass(frozen=True)
class Linearisation:
    """One recording against one vehicle: t (m,) s; residual (m, c), zero where not `good` (m,); columns (p, m, c), the
    change of the residual per unit `step` of each parameter of the effects, in their order."""

    t: np.ndarray
    residual: np.ndarray
    sensitivity: np.ndarray
    good: np.ndarray


def with_effect_terms(vehicle: Vehicle, effects: tuple[Effect, ...]) -> Vehicle:
    """Return the vehicle with every effect's terms, idle where it lacks them."""
    return with_idle_terms(vehicle, idle_terms(effects))


def parameter_steps(effects: tuple[Effect, ...]) -> np.ndarray:
    """Return the step (p,) of each parameter."""
    return np.array([parameter.step for effect in effects for parameter in effect.parameters])


def parameter_slices(effects: tuple[Effect, ...]) -> dict[str, slice]:
    """Return where each effect's parameters stand, by its key."""
    found, begin = {}, 0
    for effect in effects:
        found[effect.key] = slice(begin, begin + len(effect.parameters))
        begin += len(effect.parameters)
    return found


def perturbed_variants(vehicle: Vehicle, effects: tuple[Effect, ...], central: bool = True) -> Variants:
    """Return the vehicle with all terms, and next to it each parameter of each effect moved by its step: up, and down
    where `central`.

    What moves measurements in time is moved both ways in any case: between samples noise is averaged, earlier as well
    as later, and a one-sided difference would take that for the effect's own.
    """
    vehicle = with_effect_terms(vehicle, effects)
    vehicles, changes, sides = [vehicle], [""], []
    for effect in effects:
        values = file_values(effect, vehicle)
        both = central or effect.retimes
        for i, parameter in enumerate(effect.parameters):
            sides.append((len(vehicles), len(vehicles) + 1 if both else 0))
            for sign in (1.0, -1.0) if both else (1.0,):
                moved = values.copy()
                moved[i] += sign * parameter.step
                vehicles.append(inject(vehicle, effect, moved))
                changes.append(CHANGES.get(effect.layer, "motion"))
    return Variants(tuple(vehicles), tuple(changes), tuple(sides))


def linearise(residual_model: ResidualModel, variants: Variants) -> Linearisation:
    """Return residuals of a vehicle and the footprints of all effects: differences of inject and replay."""
    residual = residual_model.residuals(variants)
    good = residual_model.good
    residual[:, ~good] = 0.0
    first = residual[0].copy()
    for column, (above, below) in zip(residual, variants.sides, strict=False):  # in place of vehicles already done with
        np.subtract(residual[above], residual[below] if below else first, out=column)
        if below:
            column /= 2.0
    return Linearisation(residual_model.t, first, residual[: len(variants.sides)], good)


def linearise_all(residual_models: list[ResidualModel], variants: Variants) -> list[Linearisation]:
    """Return the linearisations of many recordings, as many at once as there are cores."""
    first = linearise(residual_models[0], variants)  # which works out what all need of the variants
    return [first, *run_in_threads(*(partial(linearise, one, variants) for one in residual_models[1:]))]


class LinearisationCache:
    """The last linearisations of recordings: a search comes back to vehicles that it has tried."""

    KEPT = 3

    def __init__(self):
        self._kept: list[tuple[tuple, tuple, list[Linearisation]]] = []

    def lines(
        self, residual_models: tuple[ResidualModel, ...], vehicle: Vehicle, effects: tuple[Effect, ...], central: bool
    ) -> list[Linearisation]:
        """Return the linearisation of each recording; arguments as of `variants_of`."""
        asked = vehicle, effects, central
        found = next((lines for own, known, lines in self._kept if own is residual_models and known == asked), None)
        if found is None:
            variants = perturbed_variants(vehicle, effects, central)
            found = [linearise(one, variants) for one in residual_models]
        self._kept = [(residual_models, asked, found), *(one for one in self._kept if one[2] is not found)][: self.KEPT]
        return found


def noise_floor(lines: list[Linearisation], channels) -> np.ndarray:
    """Return the least standard deviation (c,) that residuals of these channels can have: what nobody cares for; of
    corners, which are zero where no gate is seen, what they scatter where one is."""
    least = np.array([channel.negligible for channel in channels])
    for c in (c for c, channel in enumerate(channels) if channel.layer == "camera"):
        seen = np.concatenate([line.residual[:, c][line.residual[:, c] != 0] for line in lines])
        least[c] = np.sqrt(np.mean(np.square(seen))) if len(seen) else 1.0
    return least
