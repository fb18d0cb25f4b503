"""MCAP: any damage of a bag, with and without right checksums, gives messages, warnings or one sentence."""

import resource
import tempfile
import warnings
import zlib
from functools import cache, partial
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
import zstandard
from fuzzing import budget, count, edited, edits, result_or_refusal
from hypothesis import example, given
from hypothesis import strategies as st
from mcap.opcode import Opcode
from mcap.writer import CompressionType, Writer
from nav_msgs.msg import Odometry
from sensor_msgs.msg import Image, Imu
from std_msgs.msg import String

from swift_ros.errors import DamagedRecording, UsageError
from swift_ros.messages.serialization import serialize
from swift_ros.recording import bags, recovery
from swift_ros.recording.mcap_format.mcap_records import HEAD, MAGIC, read_records
from swift_ros.recording.mcap_format.message_definitions import schema_text
from swift_ros.track import Track

FOLDER = Path(tempfile.mkdtemp(prefix="swift-fuzz-"))
PATH = FOLDER / "bag.mcap"
KINDS = {"sensor_msgs/msg/Imu": Imu, "nav_msgs/msg/Odometry": Odometry, "std_msgs/msg/String": String}
KINDS |= {"sensor_msgs/msg/Image": Image}
COMPRESSIONS = (CompressionType.NONE, CompressionType.ZSTD, CompressionType.LZ4)
COUNT = 8  # messages of each topic
SIZES = (0, 1, -1, 1 << 60, (1 << 64) - 1, 1 << 31)


@cache
def recorded(compression: CompressionType, chunked: bool = True) -> bytes:
    """Return a bag of a few messages of four types, with custom data."""
    stream, rng = BytesIO(), np.random.default_rng(2)
    writer = Writer(stream, chunk_size=600, compression=compression, use_chunking=chunked)
    writer.start(profile="ros2")
    writer.add_metadata("swift", {"config/track.yaml": "gates: []\n", "imported": "[]"})
    channels = {
        kind: writer.register_channel(
            f"/{i}", "cdr", writer.register_schema(kind, "ros2msg", schema_text(kind).encode())
        )
        for i, kind in enumerate(KINDS)
    }
    samples = [Imu(), Odometry(), String(data="flown"), Image(data=rng.integers(0, 9, 90, dtype=np.uint8).tolist())]
    for k in range(COUNT):
        for kind, sample in zip(KINDS, samples, strict=True):
            writer.add_message(channels[kind], k * 1_000_000, serialize(sample), k * 1_000_000)
    writer.finish()
    return stream.getvalue()


def read(content: bytes, all_else: bool = True) -> int:
    """Return the number of messages of a bag that can be decoded; read all else that it holds too where asked."""
    PATH.write_bytes(content)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        number = sum(1 for _ in bags.read(PATH))
        for function in (
            partial(bags.damage, PATH),
            partial(bags.stored_record, PATH, Track, "track.yaml"),
            partial(bags.stored_json, PATH, "imported", []),
            partial(bags.require, PATH, "/none"),
        ):
            assert not all_else or isinstance(result_or_refusal(function), UsageError | list)
    assert all(issubclass(one.category, DamagedRecording) for one in caught)
    assert all(str(one.message).isprintable() for one in caught)
    return number


def assert_read_or_refused(content: bytes) -> None:
    found = result_or_refusal(partial(read, content, zlib.crc32(content) % 8 == 0))
    count("mcap", valid=not isinstance(found, UsageError))


def rebuilt(parts: list[tuple[int, bytes]]) -> bytes:
    return MAGIC + b"".join(HEAD.pack(opcode, len(body)) + body for opcode, body in parts) + MAGIC


def with_sound_checksum(body: bytes, records: bytes) -> bytes:
    """Return the content of an uncompressed chunk with other records, and their right size and checksum."""
    length = int.from_bytes(body[28:32], "little")
    head = body[:16] + len(records).to_bytes(8, "little") + zlib.crc32(records).to_bytes(4, "little")
    return head + body[28 : 32 + length] + len(records).to_bytes(8, "little") + records


@cache
def parts_of(compression: CompressionType) -> list[tuple[int, bytes]]:
    content = recorded(compression)
    return [(opcode, bytes(body)) for opcode, body in read_records(content[len(MAGIC) : -len(MAGIC)])]


@pytest.mark.parametrize("compression", COMPRESSIONS)
def test_the_unmodified_bag_is_read(compression):
    assert read(recorded(compression)) == COUNT * len(KINDS)
    assert rebuilt(parts_of(compression)) == recorded(compression)


@budget(0.1)
@given(st.binary(max_size=300), st.booleans(), st.booleans())
def test_any_bytes_are_refused(content, begins, ends):
    assert_read_or_refused(MAGIC * begins + content + MAGIC * ends)


@budget(0.3)
@given(st.sampled_from(COMPRESSIONS), st.booleans(), edits())
def test_a_damaged_file_is_read(compression, chunked, changes):
    assert_read_or_refused(edited(recorded(compression, chunked), changes))


@budget(0.3)
@given(
    st.sampled_from(COMPRESSIONS),
    st.lists(
        st.tuples(st.integers(0, 500), st.sampled_from(("edit", "drop", "double", "opcode")), edits(2)),
        min_size=1,
        max_size=3,
    ),
)
def test_records_that_are_damaged_in_themselves_are_read_or_left_out(compression, changes):
    parts = list(parts_of(compression))
    for number, kind, change in changes:
        at = number % len(parts)
        opcode, body = parts[at]
        parts[at : at + 1] = {
            "edit": [(opcode, edited(body, change))],
            "drop": [],
            "double": [parts[at]] * 2,
            "opcode": [(change[0].place % 256, body)],
        }[kind] or ([(opcode, b"")] if len(parts) == 1 else [])
    assert_read_or_refused(rebuilt(parts))


@budget(0.1)
@given(st.integers(0, 500), st.integers(0, 60), st.sampled_from(SIZES), st.sampled_from((4, 8)))
@example(0, 16, 1 << 60, 8)
def test_absurd_sizes_allocate_nothing(number, place, size, width):
    parts = list(parts_of(CompressionType.ZSTD))
    at = number % len(parts)
    opcode, body = parts[at]
    raw = (size % (1 << 8 * width)).to_bytes(width, "little")
    parts[at] = opcode, body[:place] + raw + body[place + width :]
    assert_read_or_refused(rebuilt(parts))


@budget(0.2)
@given(st.integers(0, 500), edits(3))
def test_messages_of_garbage_with_right_checksums_are_decoded_or_left_out(number, changes):
    parts = list(parts_of(CompressionType.NONE))
    chunks = [i for i, (opcode, _) in enumerate(parts) if opcode == Opcode.CHUNK]
    at = chunks[number % len(chunks)]
    opcode, body = parts[at]
    length = int.from_bytes(body[28:32], "little")
    records = bytearray()
    for inner, content in read_records(body[40 + length :]):
        content = bytes(content)
        if inner == Opcode.MESSAGE:
            content = content[:22] + edited(content[22:], changes)
        records += HEAD.pack(inner, len(content)) + content
    parts[at] = opcode, with_sound_checksum(body, bytes(records))
    assert_read_or_refused(rebuilt(parts))


@pytest.mark.parametrize("claimed", [100, 1 << 60])
def test_a_chunk_that_grows_beyond_its_size_is_left_out(claimed):
    parts = list(parts_of(CompressionType.ZSTD))
    at = next(i for i, (opcode, _) in enumerate(parts) if opcode == Opcode.CHUNK)
    bomb = zstandard.compress(bytes(1 << 28))
    body = parts[at][1]
    head = body[:16] + claimed.to_bytes(8, "little") + bytes(4) + body[28:36]
    parts[at] = Opcode.CHUNK, head + len(bomb).to_bytes(8, "little") + bomb
    begin = memory_mb()
    assert_read_or_refused(rebuilt(parts))
    assert memory_mb() - begin < 50


def memory_mb() -> float:
    """Return the largest memory that this process has had, MB."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


@budget(0.02)
@given(edits(3))
def test_the_readable_rest_is_written(changes):
    PATH.write_bytes(edited(recorded(CompressionType.ZSTD), changes))
    out = Path(tempfile.mkdtemp(dir=FOLDER)) / "out"
    found = result_or_refusal(partial(recovery.recover, PATH, out))
    if not isinstance(found, UsageError):
        assert sum(1 for _ in bags.read_raw(out)) == sum(found.counts.values())
    count("mcap", valid=not isinstance(found, UsageError))
