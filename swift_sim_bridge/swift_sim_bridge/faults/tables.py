"""Tables of the endings of races with faults."""

from collections import Counter

import numpy as np

from swift_ros.text import align
from swift_sim_bridge.faults.ending import ENDINGS, Ending


def by_kind(endings: list[Ending]) -> str:
    """Return a table of the endings by kind of fault, with times to the first safe frame and impact speeds."""
    return _table("fault", {kind: [e for e in endings if e.fault.kind == kind] for kind in _kinds(endings)})


def by_target(endings: list[Ending]) -> str:
    """Return a table of the endings by the node, topic or part that had the fault."""
    targets = sorted({ending.fault.target for ending in endings})
    return _table("in", {target: [e for e in endings if e.fault.target == target] for target in targets})


def undefined(endings: list[Ending]) -> list[str]:
    """Return a line for each ending that is undefined."""
    return [f"draw {e.fault.seed}: {e.fault.sentence}: {'; '.join(e.problems)}" for e in endings if e.problems]


def totals(endings: list[Ending]) -> str:
    """Return one line about all endings."""
    ways = Counter(ending.way for ending in endings)
    safe = [ending.safe_s for ending in endings if ending.safe_s is not None]
    counts = ", ".join(f"{ways[way]} {way}" for way in ENDINGS)
    latest = f"; first safe frame after {max(safe):.2f} s at most" if safe else ""
    return f"{len(endings)} draws: {counts}; {len(undefined(endings))} undefined{latest}"


def _kinds(endings: list[Ending]) -> list[str]:
    return sorted({ending.fault.kind for ending in endings})


def _table(heading: str, groups: dict[str, list[Ending]]) -> str:
    rows = [(heading, "draws", *ENDINGS, "undefined", "safe after s", "impact m/s")]
    for name, group in groups.items():
        ways = Counter(ending.way for ending in group)
        safe = [ending.safe_s for ending in group if ending.safe_s is not None]
        impacts = [ending.impact_m_s for ending in group if ending.impact_m_s is not None]
        rows.append(
            (
                name,
                str(len(group)),
                *(str(ways[way]) for way in ENDINGS),
                str(len(undefined(group))),
                f"{max(safe):.2f}" if safe else "-",
                f"{np.median(impacts):.1f}, up to {max(impacts):.1f}" if impacts else "-",
            )
        )
    return align(rows)
