"""Which cases a run of the referee judges: how many of each family and generator, and in which order."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, dataclass

import numpy as np

from swift_ros.errors import UsageError
from swift_sim_bridge.referee.cases import FAMILIES, MULTIPLES, REVIEW, TESTS, check_seed
from swift_sim_bridge.referee.catalogue import EFFECTS
from swift_sim_bridge.referee.simulator.rotorpy_flight import HIDES

GENERATORS = ("own", "rotorpy")
KNOWN = {"own": tuple(FAMILIES), "rotorpy": ("null", "null_sheet", "single", "pair", "confusable", "knockout")}
BATCHES = {  # of each generator, how many of each family; singles: how many of each effect at each size
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
        "rotorpy": {"null": 50, "null_sheet": 10, "single": len(HIDES) * len(MULTIPLES), "pair": 20},
    },
}


@dataclass(frozen=True)
class Entry:
    """One case of a plan. name: under which the tool sees it, which tells nothing; effect and multiple: empty where
    the seed decides."""

    name: str
    generator: str
    family: str
    seed: int
    effect: str = ""
    multiple: float = 0.0


def plan(counts: dict[str, dict[str, int]], first_seed: int, review: bool = False) -> list[Entry]:
    """Return the entries of `counts` {generator: {family: n}}, mixed, so that an order tells nothing, and as `balanced`
    has them.

    Singles go through all effects and sizes in turn. Raises UsageError for an unknown family, a seed that is kept,
    seeds of more than one kind, or no case at all.
    """
    most = max((count for families in counts.values() for count in families.values()), default=0)
    if most < 1:
        raise UsageError(
            f"there is nothing to judge: no case of {' or '.join(counts)} is in this batch; give --batch "
            "full, or --families and a --count from 1 up"
        )
    _refuse_mixed(first_seed, first_seed + most - 1)
    rows = []
    for generator, families in counts.items():
        for family, count in families.items():
            if family not in KNOWN[generator]:
                hint = "give --generator own" if family in KNOWN["own"] else f"known are {', '.join(KNOWN[generator])}"
                raise UsageError(f"the family '{family}' is unknown to {generator}; {hint}")
            for i in range(count):
                check_seed(first_seed + i, review)
                rows.append((generator, family, first_seed + i, *_single(generator, family, i, count)))
    order = np.random.default_rng(first_seed).permutation(len(rows))
    return balanced([Entry(f"flight-{number:04d}", *rows[i]) for number, i in enumerate(order, start=1)])


def balanced(entries: Sequence[Entry]) -> list[Entry]:
    """Return entries in an order of which any first part holds all families of both generators in proportion: a run
    that was stopped has judged a smaller batch of the same kind."""
    sizes, seen, shares = Counter((one.generator, one.family) for one in entries), Counter(), []
    for one in entries:
        group = one.generator, one.family
        shares.append(seen[group] / sizes[group])
        seen[group] += 1
    return [entries[i] for i in np.argsort(shares, kind="stable")]


def _refuse_mixed(first: int, last: int) -> None:
    """Raise UsageError for seeds that are partly for one purpose and partly for another."""
    for begin in (TESTS.start, REVIEW.start):
        if first < begin <= last:
            raise UsageError(
                f"this batch needs the seeds {first} to {last}, and from {begin} up they serve another "
                f"purpose; begin at {begin}, or so early that all are below it"
            )


def _single(generator: str, family: str, index: int, count: int) -> tuple[str, float]:
    """Return effect and size of the index-th single: all of them where there are enough, else spread over both."""
    if family != "single":
        return "", 0.0
    effects = HIDES if generator == "rotorpy" else tuple(EFFECTS)
    every = len(effects) * len(MULTIPLES)
    if count < every:
        index = (index * every) // count + index
    return effects[(index // len(MULTIPLES)) % len(effects)], MULTIPLES[index % len(MULTIPLES)]


def as_json(entries: Sequence[Entry]) -> list[dict]:
    """Return a plan as JSON has it, by name: in whatever order it is judged, it is the same plan."""
    return [asdict(entry) for entry in sorted(entries, key=lambda entry: entry.name)]
