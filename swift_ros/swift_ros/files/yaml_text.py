"""The content of a YAML text, with one sentence for what is wrong in it."""

import math

import yaml
from yaml.composer import Composer
from yaml.constructor import SafeConstructor

from swift_ros.errors import UsageError
from swift_ros.text import excerpt

MAX_VALUES = 100_000  # values in a file with all its references resolved: 200 times those of the largest shipped file
MAX_DEPTH = 50  # of brackets within brackets, for which the parser in Python needs a time that grows with the square
# What PyYAML raises for a text that does not fit its tag, such as `!!int x`, and for too deep a nesting.
_UNCONSTRUCTED = (ValueError, KeyError, IndexError, AttributeError, TypeError, OverflowError, RecursionError)
MERGE_MARKS = ("<<<<<<<", "=======", ">>>>>>>")  # at the begin of lines of a merge that git left to a person

LIB_YAML = getattr(yaml, "CSafeLoader", yaml.SafeLoader)  # PyYAML may have been built without LibYAML


class _Refusing(Composer, SafeConstructor):
    """What PyYAML accepts and a reader does not expect, refused.

    That is a key that stands twice, of which PyYAML takes the last one; an alias within its own anchor; and what takes
    very long.
    """

    def __init__(self, stream, parser):
        parser.__init__(self, stream)
        Composer.__init__(self)  # LibYAML's parser composes by itself and does not call it
        self._open_anchors, self._brackets = [], 0

    def compose_node(self, parent, index):
        event = self.peek_event()  # pyright: ignore[reportAttributeAccessIssue]
        if isinstance(event, yaml.AliasEvent) and event.anchor in self._open_anchors:
            problem = f"has the alias '*{excerpt(event.anchor)}' within the part that it names"
            raise _Refused(None, None, problem, event.start_mark)
        in_brackets = bool(getattr(event, "flow_style", False))
        self._brackets += in_brackets
        if self._brackets > MAX_DEPTH:
            raise _Refused(None, None, "has too many brackets within brackets", event.start_mark)
        self._open_anchors.append(None if isinstance(event, yaml.AliasEvent) else event.anchor)
        node = super().compose_node(parent, index)
        self._open_anchors.pop()
        self._brackets -= in_brackets
        return node

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


class _Loader(_Refusing, yaml.SafeLoader):
    """PyYAML's parser in Python, whose errors say most."""

    def __init__(self, stream):
        super().__init__(stream, yaml.SafeLoader)


class _FastLoader(_Refusing, LIB_YAML):  # pyright: ignore[reportGeneralTypeIssues]
    """LibYAML's parser, which takes a quarter of the time."""

    def __init__(self, stream):
        super().__init__(stream, LIB_YAML)


def _finite_float(loader, node) -> float:
    """Return the number of a node; no quantity of a configuration is infinite or no number."""
    number = loader.construct_yaml_float(node)
    if not math.isfinite(number):
        raise _Refused(None, None, f"has '{excerpt(node.value)}', which is no finite number,", node.start_mark)
    return number


class _FiniteLoader(_Loader):
    """Of numbers that must be finite."""


class _FastFiniteLoader(_FastLoader):
    """Of numbers that must be finite."""


for _each in (_FiniteLoader, _FastFiniteLoader):
    _each.add_constructor("tag:yaml.org,2002:float", _finite_float)


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


def parse_yaml(text: str, where: str, advice: str = "correct it or restore the shipped file", finite: bool = False):
    """Return the content of a YAML text.

    Args:
        text: the text.
        where: its name, for errors.
        advice: what to do about an error.
        finite: whether numbers that are not finite are refused.

    Raises:
        UsageError: it is not valid, has a key twice in a mapping, or holds more than MAX_VALUES values.
    """
    try:
        content = _content(text, finite)
    except yaml.YAMLError as error:
        raise UsageError(f"{where} {_problem(error, text)}; {advice}") from error
    except _UNCONSTRUCTED as error:
        raise UsageError(f"{where} is not valid YAML; {advice}") from error
    if not _is_small(content):
        raise UsageError(f"{where} refers to its own parts too often; {advice}")
    return content


def _content(text: str, finite: bool):
    """Return what PyYAML reads; what LibYAML refuses goes through the parser whose errors say most."""
    try:
        return yaml.load(text, _FastFiniteLoader if finite else _FastLoader)
    except _Refused:
        raise
    except yaml.YAMLError:
        return yaml.load(text, _FiniteLoader if finite else _Loader)


def _is_small(content) -> bool:
    """Return whether a content has at most MAX_VALUES values; references to its own parts count each time."""
    waiting, count = [content], 0
    while waiting and count <= MAX_VALUES:
        value = waiting.pop()
        parts = value.values() if isinstance(value, dict) else value if isinstance(value, list | tuple | set) else ()
        count += 1 + len(parts)
        waiting.extend(parts)
    return count <= MAX_VALUES
