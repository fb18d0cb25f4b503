"""The warnings of the graph's nodes on /diagnostics, as lines for a terminal."""

from swift_ros.graph.topic_table import NODES
from swift_ros.nodes.shell import LEVELS, without_numbers


class NodeWarnings:
    """Returns each warning of a node once; sentences that differ in numbers alone count as one."""

    def __init__(self):
        self._seen: set[tuple[str, str]] = set()

    def new(self, message) -> list[str]:
        """Return "NODE: sentence" for each warning and error of a node in a DiagnosticArray that is new."""
        lines = []
        for status in message.status:
            key = status.name, without_numbers(status.message)
            if status.name in NODES and status.level in (LEVELS["warn"], LEVELS["error"]) and key not in self._seen:
                self._seen.add(key)
                lines.append(f"{status.name}: {status.message}")
        return lines
