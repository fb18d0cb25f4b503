"""Records of an MCAP file: read strictly, and found again behind damage. See the MCAP specification."""

import re
import struct
from collections.abc import Iterator
from io import BytesIO

from mcap import records
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.stream_reader import get_chunk_data_stream
from zstandard import ZstdError, frame_content_size

MAGIC = b"\x89MCAP0\r\n"
HEAD = struct.Struct("<BQ")  # of a record: opcode, and number of bytes of its content
FOOTER = struct.Struct("<BQQQI")  # record with its head: begin of the summary, begin of the offsets, checksum
MESSAGE = struct.Struct("<HIQQ")  # content before the data: channel, sequence number, log time, publish time
SOUND_CHAIN = 3  # records that must follow each other for reading to resume there: a chance match has one or two

# Content of a record by its opcode; messages and chunk contents are read by this file.
_KINDS = {
    Opcode.HEADER: records.Header,
    Opcode.FOOTER: records.Footer,
    Opcode.SCHEMA: records.Schema,
    Opcode.CHANNEL: records.Channel,
    Opcode.CHUNK: records.Chunk,
    Opcode.MESSAGE_INDEX: records.MessageIndex,
    Opcode.CHUNK_INDEX: records.ChunkIndex,
    Opcode.ATTACHMENT: records.Attachment,
    Opcode.ATTACHMENT_INDEX: records.AttachmentIndex,
    Opcode.STATISTICS: records.Statistics,
    Opcode.METADATA: records.Metadata,
    Opcode.METADATA_INDEX: records.MetadataIndex,
    Opcode.SUMMARY_OFFSET: records.SummaryOffset,
    Opcode.DATA_END: records.DataEnd,
}
_FIRST_PRIVATE = 0x80  # opcode
# Heads of records of at most 64 GiB. In a file with chunks, schemas, channels and messages at the top level are not
# searched for: they would be those inside a damaged chunk, without its checksum.
_HEAD_BETWEEN_CHUNKS = re.compile(rb"[\x02\x06-\x09\x0b-\x0f](?=.{4}[\0-\x0f]\0\0\0)", re.DOTALL)
_HEAD_WITHOUT_CHUNKS = re.compile(rb"[\x03-\x05](?=.{4}[\0-\x0f]\0\0\0)", re.DOTALL)


# What a damaged record can raise: reading beyond its end, bad text, unknown numbers, failed checksums, decompression.
UNREADABLE = (
    McapError,
    EOFError,
    ValueError,
    KeyError,
    struct.error,
    MemoryError,
    OverflowError,
    RuntimeError,
    ZstdError,
)


class _Strict(BytesIO):
    """A stream that does not end inside a value."""

    def read(self, size: int | None = -1, /) -> bytes:
        data = super().read(size)
        if size is not None and len(data) < size:
            raise EOFError
        return data


def parse(opcode: int, body) -> records.McapRecord:
    """Return a record that fills its content. Raises one of UNREADABLE."""
    stream = ReadDataStream(_Strict(body))
    record = _KINDS[Opcode(opcode)].read(stream)  # pyright: ignore[reportAttributeAccessIssue]
    if stream.count != len(body):
        raise ValueError("another size")
    return record


def read_records(content) -> Iterator[tuple[int, memoryview]]:
    """Yield opcode and content of all records that lie together. Raises EOFError when the last one is incomplete."""
    view, at = memoryview(content), 0
    while at < len(view):
        if len(view) - at < HEAD.size:
            raise EOFError
        opcode, size = HEAD.unpack_from(view, at)
        at += HEAD.size
        if size > len(view) - at or (opcode == Opcode.MESSAGE and size < MESSAGE.size):
            raise EOFError
        yield opcode, view[at : at + size]
        at += size


def chunk_content(content) -> bytes:
    """Return the uncompressed records of a chunk record. Raises one of UNREADABLE."""
    opcode, size = HEAD.unpack_from(content)
    if opcode != Opcode.CHUNK or size != len(content) - HEAD.size:
        raise ValueError("no chunk")
    chunk = parse(Opcode.CHUNK, content[HEAD.size :])
    assert isinstance(chunk, records.Chunk)
    if chunk.compression == "zstd" and frame_content_size(chunk.data) not in (-1, chunk.uncompressed_size):
        raise ValueError("another size")  # before memory for it is allocated; -1: the frame does not say
    stream, size = get_chunk_data_stream(chunk, validate_crc=True)
    if size != chunk.uncompressed_size:
        raise ValueError("another size")
    return stream.read(size)


def record_at(content, at: int) -> tuple[int, memoryview, int]:
    """Return opcode and content of the record at a position, and the position behind it. Raises one of UNREADABLE.

    Messages and private records are not checked any further.
    """
    if len(content) - at < HEAD.size:
        raise EOFError
    opcode, size = HEAD.unpack_from(content, at)
    end = at + HEAD.size + size
    if end > len(content):
        raise EOFError
    ((_, body),) = read_records(content[at:end])
    if opcode != Opcode.MESSAGE and opcode < _FIRST_PRIVATE:
        parse(opcode, body)
    return opcode, body, end


def next_sound_record(content, at: int, has_chunks: bool) -> int:
    """Return the position, from `at` on, of the next records that are sound, or the end of the content."""
    found = _first_sound(content, at, _HEAD_BETWEEN_CHUNKS)
    if has_chunks or (found < len(content) and content[found] == Opcode.CHUNK):
        return found
    return min(found, _first_sound(content, at, _HEAD_WITHOUT_CHUNKS))


def _first_sound(content, at: int, head: re.Pattern) -> int:
    return next((hit.start() for hit in head.finditer(content, at) if _is_sound(content, hit.start())), len(content))


def _is_sound(content, at: int) -> bool:
    """Return whether a chunk of sound content, or SOUND_CHAIN sound records, begin at a position."""
    for _ in range(SOUND_CHAIN):
        if at == len(content) - len(MAGIC) and content[at:] == MAGIC:
            return True
        try:
            opcode, _, end = record_at(content, at)
            if opcode == Opcode.CHUNK:
                chunk_content(content[at:end])
                return True
        except UNREADABLE:
            return False
        at = end
    return True
