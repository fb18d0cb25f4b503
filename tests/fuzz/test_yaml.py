"""YAML: any text and any values give a configuration or one sentence that names the file."""

import copy
import math
import tempfile
from functools import partial
from pathlib import Path

import pytest
from fuzzing import budget, count, edited, edits, result_or_refusal
from hypothesis import example, given
from hypothesis import strategies as st

from swift_ros import configuration
from swift_ros.camera.model import Camera
from swift_ros.commands import section_table
from swift_ros.commands.checked_files import named
from swift_ros.errors import UsageError
from swift_ros.track import Track
from swift_ros.vehicle import Vehicle
from swift_sim_bridge.flight_controller.configuration.controller_section import controller_from_vehicle
from swift_sim_bridge.physics.terms.registry import coefficients_from_vehicle

FOLDER = configuration.configuration_folder()
PATH = Path(tempfile.mkdtemp(prefix="swift-fuzz-")) / "file.yaml"
FILES = {"drone.yaml": Vehicle, "vehicles/crazyflie.yaml": Vehicle, "track.yaml": Track, "camera.yaml": Camera}
SECTIONS = {
    name: {section: named(record) for section, record in sections.items()}
    for name, sections in section_table.SECTIONS.items()
}
TEXTS = {name: (FOLDER / name).read_bytes() for name in (*FILES, *SECTIONS)}
CONTENTS = {name: configuration.read_yaml(FOLDER / name) for name in TEXTS}
# Text that is special in YAML.
MARKS = (
    b"&a [*a, *a]",
    b"!!int x",
    b"!!timestamp x",
    b"!!bool x",
    b"!!int ''",
    b"!!python/object:os.system x",
    b"<<: *a",
    b"2020-99-99",
    b".nan",
    b"-.inf",
    b"1e308",
    b"0x" + b"f" * 9000,
    b"9" * 5000,
    b"[" * 3000,
    b"{" * 50,
    b"\t",
    b'"\\uD800"',
    "\u2028\u202e\U0001f681".encode(),
    b"\n---\n",
    b"? [a]\n: b",
)
SCALARS = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(),
    st.sampled_from((math.nan, math.inf, -math.inf, 1e308, -1.0, 0.0, 10**400, "", "1e400", "x" * 9000, "\n\x07")),
    st.floats(),
    st.text(max_size=8),
)
VALUES = st.recursive(
    SCALARS,
    lambda inner: st.one_of(st.lists(inner, max_size=4), st.dictionaries(SCALARS, inner, max_size=3)),
    max_leaves=6,
)
CHANGES = st.lists(
    st.tuples(
        st.lists(st.integers(0, 60), min_size=1, max_size=4), st.sampled_from(("set", "remove", "rename")), VALUES
    ),
    min_size=1,
    max_size=3,
)
BOMB = "a0: &a0 [x, x]\n" + "".join(f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 9)}]\n" for i in range(1, 12))
MERGES = "a0: &a0 {x: 1}\n" + "".join(f"a{i}: &a{i} {{<<: [{', '.join([f'*a{i - 1}'] * 9)}]}}\n" for i in range(1, 12))


def loaded(name: str, content: bytes) -> list:
    """Return all records of a configuration file with another content."""
    PATH.write_bytes(content)
    if name in FILES:
        return [checked(configuration.load(FILES[name], PATH))]
    first, *_ = SECTIONS[name].items()
    return [configuration.load_section(first[1], PATH, first[0]), *built(name, configuration.read_yaml(PATH))]


def built(name: str, content: dict) -> list:
    """Return all records of a configuration file with another content, without the detour of its text."""
    if name in FILES:
        return [checked(configuration.build(FILES[name], content, name))]
    return [configuration.build(kind, content[key], key) for key, kind in SECTIONS[name].items() if key in content]


def checked(record):
    """Return a record after the checks that a simulator makes of a vehicle."""
    if isinstance(record, Vehicle) and record.controller.get("type") == "betaflight":
        controller_from_vehicle(record)
        coefficients_from_vehicle(record)
    return record


def assert_read_or_refused(function):
    found = result_or_refusal(function)
    count("yaml", valid=not isinstance(found, UsageError))
    return found


def changed(content, place: list[int], kind: str, value):
    """Set, remove or rename one value of a nested content, at a drawn place."""
    for number in place[:-1]:
        inner = list(content.values()) if isinstance(content, dict) else content
        chosen = inner[number % len(inner)] if inner else None
        if not isinstance(chosen, dict | list) or not chosen:
            break
        content = chosen
    if isinstance(content, list):
        content[place[-1] % len(content)] = value
        return
    key = list(content)[place[-1] % len(content)]
    if kind == "set":
        content[key] = value
    else:
        old = content.pop(key)
        if kind == "rename":
            content[value if isinstance(value, str | int) else str(value)] = old


@pytest.mark.parametrize("name", TEXTS)
def test_the_unmodified_file_is_read(name):
    assert loaded(name, TEXTS[name])


@budget(0.02)
@given(st.sampled_from(sorted(TEXTS)), st.binary(max_size=200))
def test_any_bytes_are_refused(name, content):
    assert isinstance(assert_read_or_refused(partial(loaded, name, content)), UsageError)


@budget(0.1)
@given(st.sampled_from(sorted(TEXTS)), edits())
def test_a_damaged_file_is_read_or_refused(name, changes):
    assert_read_or_refused(partial(loaded, name, edited(TEXTS[name], changes)))


@budget(0.1)
@given(st.sampled_from(sorted(TEXTS)), st.integers(0, 1 << 16), st.sampled_from(MARKS), st.booleans())
@example("track.yaml", 0, BOMB.encode(), True)
@example("track.yaml", 0, MERGES.encode(), True)
@example("drone.yaml", 0, b"mass: 1\nmass: 2\n", True)
def test_special_text_is_read_or_refused(name, place, mark, at_line):
    lines = TEXTS[name].split(b"\n")
    number = place % len(lines)
    key, colon, _ = lines[number].partition(b":")
    lines[number] = lines[number] + mark if at_line or not colon else key + b": " + mark
    assert_read_or_refused(partial(loaded, name, b"\n".join(lines)))


@budget(0.78)
@given(st.sampled_from(sorted(TEXTS)), CHANGES)
def test_any_value_is_used_or_refused(name, changes):
    content = copy.deepcopy(CONTENTS[name])
    for place, kind, value in changes:
        if content:
            changed(content, place, kind, value)
    assert_read_or_refused(partial(built, name, content))


def test_a_long_text_is_not_repeated_in_an_error():
    content = CONTENTS["drone.yaml"] | {"sensors": {"gyro_rad_s": "x" * 9000}}
    assert "not 'xxx" in str(result_or_refusal(partial(built, "drone.yaml", content)))


@pytest.mark.parametrize("name", ["x" * 81, "\x1f"])
def test_a_name_that_fits_in_no_sentence_is_refused(name):
    with pytest.raises(UsageError, match="'name' must be a text of at most 80 printable letters"):
        built("drone.yaml", CONTENTS["drone.yaml"] | {"name": name})


@pytest.mark.parametrize("inertia", [{}, [{}] * 3, "abc", None, [1, 2], [math.inf] * 3, [10**400] * 3])
def test_an_inertia_of_another_form_is_refused(inertia):
    with pytest.raises(UsageError, match="'inertia' must be three positive values"):
        built("drone.yaml", CONTENTS["drone.yaml"] | {"inertia": inertia})


@pytest.mark.parametrize(("section", "key"), [("camera", "kind"), ("state_estimator", "filter"), ("vio", "rate_frame")])
@pytest.mark.parametrize("value", ["\x1f", "\ud800"])
def test_a_choice_that_cannot_be_printed_is_refused_in_a_printable_sentence(section, key, value):
    content = CONTENTS["nodes.yaml"][section] | {key: value}
    found = result_or_refusal(partial(configuration.build, SECTIONS["nodes.yaml"][section], content, section))
    assert f"'{key}' must be one of" in str(found)


@pytest.mark.parametrize("text", [BOMB, MERGES])
def test_references_that_multiply_are_refused(text):
    PATH.write_text(text)
    error = result_or_refusal(partial(configuration.read_yaml, PATH))
    assert isinstance(error, UsageError) and "refers to its own parts too often" in str(error)


def test_deep_brackets_are_refused_at_once():
    PATH.write_text("a: " + "[" * 100_000)
    with pytest.raises(UsageError, match="has too many brackets within brackets at line 1"):
        configuration.read_yaml(PATH)


def test_a_key_that_stands_twice_is_refused_with_its_line():
    PATH.write_text("mass: 1.0\nname: a\nmass: 2.0\n")
    with pytest.raises(UsageError, match="has the key 'mass' twice, at line 1 and at line 3"):
        configuration.read_yaml(PATH)
