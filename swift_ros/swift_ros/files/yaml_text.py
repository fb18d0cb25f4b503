"""The content of a YAML text, with one sentence for what is wrong in it."""

import math

import yaml

from swift_ros.errors import UsageError
from swift_ros.text import excerpt

MAX_VALUES = 100_000  # values in a file with all its references resolved: 200 times those of the largest shipped file
MAX_DEPTH = 50  # of brackets within brackets, for which PyYAML needs a time that grows with the square
# What PyYAML raises for a text that does not fit its tag, such as `!!int x`, and for too deep a nesting.
_UNCONSTRUCTED = (ValueError, KeyError, IndexError, AttributeError, TypeError, OverflowError, RecursionError)
MERGE_MARKS = ("<<<<<<<", "=======", ">>>>>>>")  # at the begin of lines of a merge that git left to a person


class _Loader(yaml.SafeLoader):
    """A loader that refuses what PyYAML accepts and a reader does not expect.

    That is a key that stands twice, of which PyYAML takes the last one; an alias within its own anchor; and what takes
    very long.
    """

    def __init__(self, stream):
        super().__init__(stream)
        self._open_anchors = []

    def compose_node(self, parent, index):
        event = self.peek_event()
        if isinstance(event, yaml.AliasEvent) and event.anchor in self._open_anchors:
            problem = f"has the alias '*{excerpt(event.anchor)}' within the part that it names"
            raise _Refused(None, None, problem, event.start_mark)
        self._open_anchors.append(None if isinstance(event, yaml.AliasEvent) else event.anchor)
        node = super().compose_node(parent, index)
        self._open_anchors.pop()
        return node

    def fetch_flow_collection_start(self, TokenClass):
        if self.flow_level >= MAX_DEPTH:
            raise _Refused(None, None, "has too many brackets within brackets", self.get_mark())
        super().fetch_flow_collection_start(TokenClass)

    def compose_mapping_node(self, anchor):
        node = super().compose_mapping_node(anchor)
        places = {}
        for key, _ in node.value:
            if isinstance(key, yaml.ScalarNode) and places.setdefault(key.value, key) is not key:
                first = places[key.value].start_mark.line + 1
                problem = f"has the key '{excerpt(key.value)}' twice, at line {first} and"
                raise _Refused(None, None, problem, key.start_mark)
        return node

    def flatten_mapping(self, node):
        super().flatten_mapping(node)
        if len(node.value) > MAX_VALUES:
            raise _Refused(None, None, "refers to its own parts too often", node.start_mark)


class FiniteLoader(_Loader):
    """A loader that also refuses numbers that are not finite: no quantity of a configuration is."""

    def construct_yaml_float(self, node):
        number = super().construct_yaml_float(node)
        if not math.isfinite(number):
            raise _Refused(None, None, f"has '{excerpt(node.value)}', which is no finite number,", node.start_mark)
        return number


FiniteLoader.add_constructor("tag:yaml.org,2002:float", FiniteLoader.construct_yaml_float)


class _Refused(yaml.constructor.ConstructorError):
    """YAML that PyYAML would accept."""


def _problem(error: yaml.YAMLError, text: str) -> str:
    """Return what is wrong with a YAML text, and at which line."""
    for number, line in enumerate(text.split("\n"), start=1):
        if line.startswith(MERGE_MARKS):
            return f"has the mark '{line[:7]}' of an unresolved merge at line {number}"
    mark, words = getattr(error, "problem_mark", None), str(getattr(error, "problem", ""))
    line = text.split("\n")[mark.line] if mark else ""
    if isinstance(error, _Refused):
        problem = words
    elif "\t" in line[: len(line) - len(line.lstrip())]:
        problem = "is indented by a tab, where YAML needs spaces,"
    elif "another document" in words:
        problem = "begins a second document"
    else:
        problem = "is not valid YAML"
    return problem + (f" at line {mark.line + 1}" if mark else "")


def parse_yaml(text: str, where: str, advice: str = "correct it or restore the shipped file", loader=_Loader):
    """Return the content of a YAML text.

    Args:
        text: the text.
        where: its name, for errors.
        advice: what to do about an error.
        loader: what refuses more than PyYAML does.

    Raises:
        UsageError: it is not valid, has a key twice in a mapping, or holds more than MAX_VALUES values.
    """
    try:
        content = yaml.load(text, loader)
    except yaml.YAMLError as error:
        raise UsageError(f"{where} {_problem(error, text)}; {advice}") from error
    except _UNCONSTRUCTED as error:
        raise UsageError(f"{where} is not valid YAML; {advice}") from error
    if not _is_small(content):
        raise UsageError(f"{where} refers to its own parts too often; {advice}")
    return content


def _is_small(content) -> bool:
    """Return whether a content has at most MAX_VALUES values; references to its own parts count each time."""
    waiting, count = [content], 0
    while waiting and count <= MAX_VALUES:
        value = waiting.pop()
        parts = value.values() if isinstance(value, dict) else value if isinstance(value, list | tuple | set) else ()
        count += 1 + len(parts)
        waiting.extend(parts)
    return count <= MAX_VALUES
