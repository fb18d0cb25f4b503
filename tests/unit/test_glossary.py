"""Retired words of docs/glossary.md stay out of names, docstrings, comments, messages and pages."""

import ast
import io
import re
import tokenize
from functools import cache
from pathlib import Path
from typing import NamedTuple

import pytest

CODE = ("swift_ros", "swift_sim_bridge", "tests", "scripts")
TEXT = ("README.md", "CONTRIBUTING.md", "CHANGELOG.md", "Makefile", "docs/**/*.md", "config/**/*.yaml")
TEXT += ("swift_msgs/msg/*.msg", "pyproject.toml", "swift_*/package.xml")
EXEMPT = ("tests/unit/test_glossary.py",)
HISTORY = {  # files, and the heading from which on they quote earlier versions
    "docs/glossary.md": "## Retired words",
    "CHANGELOG.md": "## [0.1.0]",
}
ALLOWED_NAMES = {  # identifiers that hold a retired word in its ordinary meaning, and why; PATH:NAME in one file only
    **dict.fromkeys(
        ("unknown_keys", "unknown_names", "refuse_unknown", "_refuse_unknown", "refuse_unknown_terms"),
        "keys of a file that no dataclass has",
    ),
    **dict.fromkeys(
        ("judged_ns", "_judged_ns", "take_judged_time", "_on_judged"), "stamps of the topic race/judged, a public name"
    ),
    **dict.fromkeys(("settle_s", "SETTLE_S"), "settling time, a term of control engineering"),
    "unknown_temperature": "what MAVLink calls it",
    "_absorbs_unknown_cause": "the verdict *unknown* of a report",
    **dict.fromkeys(
        (
            f"swift_sim_bridge/swift_sim_bridge/gate_detector/{file}.py:judged"
            for file in ("images/composed", "images/labelled", "images/rendered", "training/settings")
        ),
        "key of config/training.yaml",
    ),
    "swift_ros/swift_ros/recording/bag_writer.py:tell": "method of a file object in Python",
    "swift_sim_bridge/swift_sim_bridge/pilot/ppo.py:all_gather": "function of JAX",
}
ALLOWED_TEXT = re.compile("cannot[ _]tell")  # the verdict of a report, a public name


class Hit(NamedTuple):
    """One use of a retired word: file relative to the repository, line, the word, and the name or text around it."""

    path: str
    line: int
    word: str
    text: str

    def __str__(self):
        return f"{self.path}:{self.line}: '{self.word}' in {self.text!r}"


@pytest.fixture(scope="module")
def retired(repository) -> tuple[set[str], set[str]]:
    return retired_words((repository / "docs/glossary.md").read_text())


def retired_words(glossary: str) -> tuple[set[str], set[str]]:
    """Return the words that are retired everywhere, and those that are retired as names only."""
    everywhere, names = set(), set()
    for words, where in re.findall(r"(?m)^\| ([^|]+) \| (everywhere|name) \|", glossary):
        (everywhere if where == "everywhere" else names).update(word.strip() for word in words.split(","))
    return everywhere, names


def hits_in_code(path: str, source: str, retired: tuple[set[str], set[str]]) -> list[Hit]:
    """Return the uses of retired words in the names, strings and comments of a Python file.

    The name of a test is a sentence: words that are retired as names only are allowed in it.
    """
    everywhere, names = retired
    if (everywhere | names).isdisjoint(parts(source) | parts(Path(path).stem) | letters(source)):
        return []  # most files: parsing takes long
    tree = ast.parse(source)
    found = [
        Hit(path, line, word, name)
        for name, line in {(Path(path).stem, 1), *identifiers(tree)}
        if name not in ALLOWED_NAMES and f"{path}:{name}" not in ALLOWED_NAMES
        for word in parts(name) & (everywhere if name.startswith("test_") else everywhere | names)
    ]
    for item in ast.walk(tree):
        if isinstance(item, ast.Constant) and isinstance(item.value, str):
            found += hits_in_text(path, item.value, everywhere, item.lineno)
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type == tokenize.COMMENT:
            found += hits_in_text(path, token.string, everywhere, token.start[0])
    return found


def hits_in_text(path: str, text: str, words: set[str], first_line: int = 1) -> list[Hit]:
    """Return the uses of words in a text that begins at a line of a file."""
    if words.isdisjoint(letters(text)):
        return []
    pattern = pattern_of(frozenset(words))
    return [
        Hit(path, first_line + number, match[1].lower(), line.strip()[:100])
        for number, line in enumerate(text.splitlines())
        for match in pattern.finditer(ALLOWED_TEXT.sub("", line))
    ]


def letters(text: str) -> set[str]:
    """Return the runs of letters of a text, in lower case."""
    return set(re.findall("[a-z]+", text.lower()))


@cache
def pattern_of(words: frozenset[str]) -> re.Pattern:
    return re.compile(rf"(?i)(?<![a-z])({'|'.join(sorted(words))})(?![a-z])")


def identifiers(tree: ast.Module) -> set[tuple[str, int]]:
    """Return every name that a Python file defines or uses, with its line."""
    found = set()
    for item in ast.walk(tree):
        line = getattr(item, "lineno", 1)
        for field in ("id", "attr", "arg", "name", "asname"):
            value = getattr(item, field, None)
            if isinstance(value, str):
                found |= {(part, line) for part in value.split(".")}
        if isinstance(item, ast.ImportFrom) and item.module:
            found |= {(part, line) for part in item.module.split(".")}
    return found


def parts(name: str) -> set[str]:
    """Return the words of an identifier, or of a file of them: the parts between underscores and capitals."""
    words = re.findall(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+", name)
    return {word.lower() for word in words}


def test_the_table_of_retired_words_is_read(retired):
    everywhere, names = retired
    assert {"told", "footprints", "unrest"} <= everywhere
    assert {"gather", "copies"} <= names


def test_planted_words_are_found_with_their_lines():
    source = "\n".join(
        (
            "def gather(x):",
            '    """Return it.',
            "",
            "    It is told.",
            '    """',
            "    told_early = x  # owed",
            "    return told_early",
            "",
        )
    )
    found = hits_in_code("a.py", source, ({"told", "owed"}, {"gather"}))
    assert sorted({(hit.line, hit.word) for hit in found}) == [
        (1, "gather"),
        (4, "told"),
        (6, "owed"),
        (6, "told"),
        (7, "told"),
    ]


def test_ordinary_words_are_not_found():
    source = 'def collect(made_of):\n    """Return what is unknown, settled and intelligible."""\n'
    assert hits_in_code("a.py", source, ({"tell", "told"}, {"unknown", "settle"})) == []


def test_no_retired_word_is_in_the_code(repository, retired):
    found = []
    for folder in CODE:
        for path in sorted((repository / folder).rglob("*.py")):
            name = path.relative_to(repository).as_posix()
            if name not in EXEMPT and "/build/" not in name:
                found += hits_in_code(name, path.read_text(), retired)
    assert not found, "\n" + "\n".join(map(str, sorted(set(found))))


def test_no_retired_word_is_in_a_page_or_configuration(repository, retired):
    found = []
    for pattern in TEXT:
        for path in sorted(repository.glob(pattern)):
            name = path.relative_to(repository).as_posix()
            text = path.read_text().partition(HISTORY.get(name, "\0"))[0]
            found += hits_in_text(name, text, retired[0])
    assert not found, "\n" + "\n".join(map(str, found))
