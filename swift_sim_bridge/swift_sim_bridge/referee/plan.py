"""The cases of a batch: how many of each family and generator, and in which order."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, dataclass

import numpy as np

from swift_ros.errors import UsageError
from swift_sim_bridge.referee.effects.catalogue import EFFECTS
from swift_sim_bridge.referee.families import FAMILIES, MULTIPLES, REVIEW_SEEDS, TEST_SEEDS, check_seed
from swift_sim_bridge.referee.simulator.rotorpy_flight import EFFECTS_OF_ROTORPY

GENERATORS = ("own", "rotorpy")
FOREIGN = ("null_foreign", "foreign", "foreign_pair")
POSE_COMMANDS = "null_pose_commands", "pose_commands", "null_foreign_pose_commands", "foreign_pose_commands"
FAMILIES_OF = {
    "own": tuple(FAMILIES),
    "rotorpy": ("null", "null_sheet", "single", "pair", "confusable", "knockout", *FOREIGN, *POSE_COMMANDS, "far"),
}
BATCHES = {  # by generator, the number of cases of each family; singles: one of each effect at each size
    "small": {"own": {"null": 4, "single": 6, "pair": 2}, "rotorpy": {}},
    "full": {
        "own": {
            "null": 160,
            "null_sheet": 20,
            "null_pilot": 20,
            "single": len(EFFECTS) * len(MULTIPLES),
            "pair": 60,
            "triple": 30,
            "confusable": 80,
            "poor": 60,
            "knockout": 60,
            "lacking": 48,
            "sheet": 20,
            "gusty": 20,
        },
        "rotorpy": {"null": 50, "null_sheet": 10, "single": len(EFFECTS_OF_ROTORPY) * len(MULTIPLES), "pair": 20},
    },
    "foreign": {
        "own": dict(zip(FOREIGN, (100, 3 * len(EFFECTS), 60), strict=True)),
        "rotorpy": dict(zip(FOREIGN, (50, 3 * len(EFFECTS_OF_ROTORPY), 20), strict=True)),
    },
}


@dataclass(frozen=True)
class Entry:
    """One case of a plan.

    Attributes:
        name: name that the tool sees; it contains no information on the case.
        generator: simulator of the flight, `own` or `rotorpy`.
        family: key of `families.FAMILIES`.
        seed: seed of the case.
        effect: hidden effect; empty if the seed determines it.
        multiple: its size relative to the detectable size; 0 if the seed determines it.
    """

    name: str
    generator: str
    family: str
    seed: int
    effect: str = ""
    multiple: float = 0.0


def make_plan(counts: dict[str, dict[str, int]], first_seed: int, review: bool = False) -> list[Entry]:
    """Return the entries of a batch.

    They are shuffled, so that the order contains no information on a case, and then balanced (see `balanced`). Singles
    have all effects and sizes in turn.

    Args:
        counts: {generator: {family: number of cases}}.
        first_seed: seed of the first case of each family.
        review: whether seeds for reviews are allowed.

    Raises:
        UsageError: a family is unknown, a seed is reserved, the seeds serve more than one purpose, or there is no
            case.
    """
    most = max((count for families in counts.values() for count in families.values()), default=0)
    if most < 1:
        raise UsageError(
            f"there is nothing to evaluate: no case of {' or '.join(counts)} is in this batch; give --batch "
            "full, or --families and a --count from 1 up"
        )
    _refuse_mixed(first_seed, first_seed + most - 1)
    rows = []
    for generator, families in counts.items():
        for family, count in families.items():
            if family not in FAMILIES_OF[generator]:
                hint = (
                    "give --generator own"
                    if family in FAMILIES_OF["own"]
                    else f"known are {', '.join(FAMILIES_OF[generator])}"
                )
                raise UsageError(f"the family '{family}' is unknown to {generator}; {hint}")
            for i in range(count):
                check_seed(first_seed + i, review)
                rows.append((generator, family, first_seed + i, *_single(generator, family, i, count)))
    order = np.random.default_rng(first_seed).permutation(len(rows))
    return balanced([Entry(f"flight-{number:04d}", *rows[i]) for number, i in enumerate(order, start=1)])


def balanced(entries: Sequence[Entry]) -> list[Entry]:
    """Return entries in an order in which every first part has all families of both generators in proportion.

    A run that is stopped has then evaluated a smaller batch of the same composition.
    """
    sizes, counted, shares = Counter((one.generator, one.family) for one in entries), Counter(), []
    for one in entries:
        group = one.generator, one.family
        shares.append(counted[group] / sizes[group])
        counted[group] += 1
    return [entries[i] for i in np.argsort(shares, kind="stable")]


def _refuse_mixed(first: int, last: int) -> None:
    """Raise UsageError if the seeds from first to last serve more than one purpose."""
    for begin in (TEST_SEEDS.start, REVIEW_SEEDS.start):
        if first < begin <= last:
            raise UsageError(
                f"this batch needs the seeds {first} to {last}, and from {begin} up they serve another "
                f"purpose; begin at {begin}, or so early that all are below it"
            )


def _single(generator: str, family: str, index: int, count: int) -> tuple[str, float]:
    """Return effect and size of a single: all combinations if there are enough cases, else spread over both."""
    if family != "single":
        return "", 0.0
    effects = EFFECTS_OF_ROTORPY if generator == "rotorpy" else tuple(EFFECTS)
    every = len(effects) * len(MULTIPLES)
    if count < every:
        index = (index * every) // count + index
    return effects[(index // len(MULTIPLES)) % len(effects)], MULTIPLES[index % len(MULTIPLES)]


def plan_as_json(entries: Sequence[Entry]) -> list[dict]:
    """Return a plan for JSON, sorted by name: plans are equal if they differ in their order alone."""
    return [asdict(entry) for entry in sorted(entries, key=lambda entry: entry.name)]
