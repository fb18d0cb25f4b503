"""Damaged bags: every message outside the damaged parts is read, none is invented, and what is missing is named."""

import warnings
from io import BytesIO

import numpy as np
import pytest
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, Message
from mcap.stream_reader import breakup_chunk
from mcap.writer import CompressionType, Writer
from rosbags.highlevel import AnyReader
from sensor_msgs.msg import Imu

from swift_ros import cli
from swift_ros.errors import DamagedRecording, UsageError
from swift_ros.messages.serialization import serialize
from swift_ros.recording import bags
from swift_ros.recording.bag_writer import BagWriter
from swift_ros.track import Track

TOPICS = {"/swift/imu": (60, 320), "/swift/camera/image": (20_000, 30), "/swift/vio/odometry": (700, 100)}  # bytes, Hz
TYPE = "std_msgs/msg/ByteMultiArray"
SECONDS = 4.0


def recorded(seed=0):
    """Yield (topic, data, time in ns) of a recording: noise, and images that compress well."""
    rng = np.random.default_rng(seed)
    rows = [
        (round(k * 1e9 / hz) + 5, topic, size) for topic, (size, hz) in TOPICS.items() for k in range(int(SECONDS * hz))
    ]
    for time_ns, topic, size in sorted(rows):
        noise = rng.integers(0, 256, size, dtype=np.uint8)
        yield topic, (noise // 64 if "image" in topic else noise).tobytes(), time_ns


def write_recorded(folder, finished):
    """Write a bag as the recorder does."""
    writer = BagWriter(folder, {"config/drone.yaml": "mass: 0.87\n"})
    for topic in TOPICS:
        writer.add_topic(topic, TYPE)
    for topic, data, time_ns in recorded():
        writer.write(topic, data, time_ns)
    if finished:
        writer.close()
    return bags.mcap_files(folder)[0]


def write_foreign(path, compression, chunked=True):
    """Write a file with mcap's own writer, as other tools do."""
    with open(path, "wb") as stream:
        writer = Writer(stream, chunk_size=100_000, compression=compression, use_chunking=chunked)
        writer.start(profile="ros2")
        schema = writer.register_schema(TYPE, "ros2msg", b"byte[] data")
        channels = {topic: writer.register_channel(topic, "cdr", schema) for topic in TOPICS}
        for topic, data, time_ns in recorded():
            writer.add_message(channels[topic], time_ns, data, time_ns)
        writer.finish()
    return path


def chunks(content: bytes):
    """Yield the byte range and the messages of each chunk of a sound file, by mcap's own reader."""
    topics, at = {}, 8
    while content[at] != Opcode.DATA_END:
        size = int.from_bytes(content[at + 1 : at + 9], "little")
        if content[at] == Opcode.CHUNK:
            chunk = Chunk.read(ReadDataStream(BytesIO(content[at + 9 : at + 9 + size])))
            rows = breakup_chunk(chunk)
            topics |= {row.id: row.topic for row in rows if isinstance(row, Channel)}
            found = {(topics[row.channel_id], row.data, row.log_time) for row in rows if isinstance(row, Message)}
            yield at, at + 9 + size, found
        at += 9 + size


def damaged(content: bytes, rng) -> tuple[bytes, int, int]:
    """Return a content with one damage, and the byte range of the original that it touches."""
    at, size = int(rng.integers(len(content))), int(rng.integers(1, 5000))
    end = min(at + size, len(content))
    match rng.integers(6):
        case 0:  # four bytes zeroed
            end = min(at + 4, len(content))
            return content[:at] + bytes(end - at) + content[end:], at, end
        case 1:  # one bit flipped
            return content[:at] + bytes([content[at] ^ 1 << int(rng.integers(8))]) + content[at + 1 :], at, at + 1
        case 2:  # overwritten by noise
            return content[:at] + rng.bytes(end - at) + content[end:], at, end
        case 3:  # a part is missing
            return content[:at] + content[end:], at, end
        case 4:  # something is inserted
            return content[:at] + rng.bytes(size) + content[at:], at, at + 1
        case _:  # cut
            return content[:at], at, len(content)


def read(path):
    """Return topic, data and log time of all messages, and the warnings."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        found = [(raw.topic, raw.data, raw.log_time_ns) for raw in bags.read_raw(path)]
    assert all(issubclass(warning.category, DamagedRecording) for warning in caught)
    return found, [str(warning.message) for warning in caught]


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    folder = tmp_path_factory.mktemp("bags")
    found = {
        "finished": write_recorded(folder / "finished", True),
        "killed": write_recorded(folder / "killed", False),
        "uncompressed": write_foreign(folder / "none.mcap", CompressionType.NONE),
        "lz4": write_foreign(folder / "lz4.mcap", CompressionType.LZ4),
    }
    return found


@pytest.mark.parametrize("kind", ["finished", "killed", "uncompressed", "lz4"])
def test_every_message_outside_the_damage_is_read_and_none_is_invented(files, kind, tmp_path):
    rng, content = np.random.default_rng(4), files[kind].read_bytes()
    sound, nothing = read(files[kind])
    assert nothing == []
    assert len(sound) == len(set(sound)) and [row[2] for row in sound] == sorted(row[2] for row in sound)
    parts = list(chunks(content))
    assert set().union(*(rows for *_, rows in parts)) == set(sound) and len(parts) >= 10
    path = tmp_path / "damaged.mcap"
    for draw in range(64):
        bad, first, end = damaged(content, rng)
        path.write_bytes(bad)
        found, said = read(path)
        untouched = [rows for begin, stop, rows in parts if stop <= first or begin >= end]
        assert set(found) <= set(sound), (kind, draw, "invented")
        missing = set().union(*untouched) - set(found)
        assert not missing, (kind, draw, first, end, len(missing), said)
        assert said or set(found) == set(sound), (kind, draw, "lost without a word")


@pytest.mark.parametrize("kind", ["finished", "uncompressed", "lz4"])
def test_a_file_that_is_cut_between_two_records_is_named(files, kind, tmp_path):
    content, cut = files[kind].read_bytes(), tmp_path / "cut.mcap"
    _, stop, _ = list(chunks(content))[4]
    cut.write_bytes(content[:stop])
    found, said = read(cut)
    assert 0 < len(found) < len(read(files[kind])[0])
    assert len(said) == 1 and "the file was cut there" in said[0]


def test_a_damaged_bag_is_recovered_as_a_sound_one(files, tmp_path, capsys):
    content = files["finished"].read_bytes()
    (begin, stop, lost), *_ = list(chunks(content))[5:]
    bag = tmp_path / "bag"
    bag.mkdir()
    (bag / "bag_0.mcap").write_bytes(content[: begin + 50] + bytes(4) + content[begin + 54 :])
    recovered = tmp_path / "recovered"
    assert cli.main(["recover", str(bag), "--out", str(recovered)]) == 0
    said = capsys.readouterr().out
    assert f"bytes {begin} to {stop} of bag_0.mcap are damaged: the messages from" in said
    assert set(read(recovered)[0]) == set(read(files["finished"])[0]) - lost and read(recovered)[1] == []
    assert bags.custom_data(recovered) == {"config/drone.yaml": "mass: 0.87\n"}
    with AnyReader([recovered]) as reader:
        assert reader.message_count == sum(1 for _ in bags.read_raw(recovered))
    assert (
        cli.main(["recover", str(bag), "--out", str(recovered)]) == 2
        and "holds a bag already" in capsys.readouterr().err
    )


def test_a_command_warns_of_damage_once_and_goes_on(files, tmp_path, capsys, monkeypatch):
    content, cut = files["finished"].read_bytes(), tmp_path / "cut.mcap"
    cut.write_bytes(content[: len(content) // 2])
    monkeypatch.setattr(cli, "run", lambda argv: [len(list(bags.read_raw(cut))) for _ in range(2)][0])
    assert cli.main([]) > 500
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(f"swiftros: warning: {cut}: bytes ") and "the file was cut there" in line


def test_a_message_that_cannot_be_decoded_is_left_out_with_a_warning(tmp_path):
    writer = BagWriter(tmp_path / "bag")
    writer.add_topic("/swift/imu/data_raw", "sensor_msgs/msg/Imu")
    for k, data in enumerate((serialize(Imu()), b"no CDR", serialize(Imu()))):
        writer.write("/swift/imu/data_raw", data, k)
    writer.close()
    with pytest.warns(DamagedRecording, match="messages of /swift/imu/data_raw that cannot be decoded are left out"):
        assert [time_ns for *_, time_ns in bags.read(tmp_path / "bag")] == [0, 2]


def test_a_damaged_configuration_in_a_bag_is_named(tmp_path):
    writer = BagWriter(tmp_path / "bag", {"config/track.yaml": "gates: [", "parameters": "{", "imported": "{}"})
    writer.close()
    with pytest.raises(UsageError, match=r"config/track.yaml is damaged: it is not valid YAML"):
        bags.stored_record(tmp_path / "bag", Track, "track.yaml")
    for name, default in (("parameters", {}), ("imported", [])):
        with pytest.raises(UsageError, match=f"'{name}' is damaged"):
            bags.stored_json(tmp_path / "bag", name, default)
