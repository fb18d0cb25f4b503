"""MSP: no bytes stop a parser, valid frames between invalid ones are found, and payloads of any size are handled."""

import random
import time

from fuzzing import FRAMES_PER_INPUT, budget, count, edited, edits, result_or_refusal
from hypothesis import example, given
from hypothesis import strategies as st
from simulated_controller import ControllerRig

from swift_ros.betaflight import msp, read_back
from swift_ros.betaflight import msp_messages as wire
from swift_ros.betaflight.link_settings import RECEIVERS
from swift_ros.betaflight.msp_messages import Code
from swift_ros.betaflight.msp_session import KNOWN, REQUESTS, MspSession
from swift_ros.errors import UsageError
from swift_sim_bridge.flight_controller.msp_server import ANSWERS, MspServer

STREAM = 1000  # frames in one example
KINDS = (msp.REQUEST, msp.REPLY, msp.REFUSAL)
RECORDS = (
    wire.ApiVersion,
    wire.FcVersion,
    wire.FeatureConfig,
    wire.RxConfig,
    wire.FailsafeConfig,
    wire.AdvancedConfig,
    wire.PidAdvanced,
    wire.RcTuning,
    wire.RcDeadband,
    wire.Analog,
    wire.BatteryState,
    wire.Attitude,
    wire.MotorConfig,
)
DECODERS = (wire.decode_status, wire.decode_motor_telemetry)
LISTS = (wire.decode_mode_ranges, wire.decode_names, wire.decode_channels)
REPLIED = (*KNOWN, *wire.Code, 0, 254)
RIG = ControllerRig()
STREAMS = st.builds(
    dict,
    seed=st.integers(0, (1 << 32) - 1),
    frames=st.just(STREAM),
    damaged_share=st.sampled_from((0.0, 0.01, 0.2, 0.5, 1.0)),
    chunk=st.sampled_from((3, 64, 512, 512, 4096, 4096)),
)


def drawn_frame(rng: random.Random, codes, kinds) -> tuple[msp.Message, bytes]:
    """Return a message of drawn content, and its frame."""
    version = 1 + rng.getrandbits(1)
    size = rng.choice((0, 0, 1, 2, 5, 8, 16, 32, 48)) if rng.random() < 0.995 else rng.choice((192, 255, 700, 4096))
    code = rng.choice(codes) if rng.random() < 0.7 else rng.randrange(65536)
    code %= 65536 if version == 2 else msp.INNER_V2
    message = msp.Message(int(code), rng.randbytes(size), rng.choice(kinds), version)
    return message, msp.encode(message)


def damaged_frame(rng: random.Random, frame: bytes) -> bytes:
    """Return a frame with one damage: bytes flipped, lost, doubled or inserted, or another size in its header."""
    found, at = bytearray(frame), rng.randrange(len(frame))
    match rng.randrange(7):
        case 0:
            found[at] ^= 1 << rng.randrange(8)
        case 1:
            del found[at : at + rng.randrange(1, 9)]
        case 2:
            found[at:at] = rng.randbytes(rng.randrange(1, 9))
        case 3:
            found[at:at] = found[: rng.randrange(1, 12)]
        case 4:  # the claimed size
            found[3 if found[1] == ord("M") else 6] = rng.choice((0, 1, 254, 255))
        case 5:
            found[3:8] = b"\xff" * len(found[3:8])
        case _:
            found = bytearray(rng.randbytes(len(frame)))
    return bytes(found)


def drawn_stream(seed: int, frames: int, damaged_share: float, codes=REPLIED, kinds=KINDS):
    """Return the messages whose frames are whole, and the bytes of all frames."""
    rng, whole, parts = random.Random(seed), [], []
    for _ in range(frames):
        message, frame = drawn_frame(rng, codes, kinds)
        if rng.random() < damaged_share:
            frame = damaged_frame(rng, frame)
        else:
            whole.append(message)
        parts.append(frame)
    return whole, b"".join(parts)


def chunks(stream: bytes, size: int):
    return (stream[at : at + size] for at in range(0, len(stream), size))


@budget(0.4, STREAM / FRAMES_PER_INPUT)
@given(STREAMS)
@example({"seed": 0, "frames": 20, "damaged_share": 0.5, "chunk": 1})
def test_any_stream_is_parsed(drawn):
    whole, stream = drawn_stream(drawn["seed"], drawn["frames"], drawn["damaged_share"])
    parser, found = msp.Parser(), []
    for chunk in chunks(stream, drawn["chunk"]):
        found += parser.feed(chunk)
    if drawn["damaged_share"] == 0.0:
        assert found == whole and parser.bad == 0
    assert all(len(message.payload) <= msp.MAX_PAYLOAD for message in found)
    count("msp", drawn["frames"], len(found))


@budget(0.3, STREAM / FRAMES_PER_INPUT)
@given(STREAMS)
def test_any_stream_is_taken_by_the_session(drawn):
    _, stream = drawn_stream(drawn["seed"], drawn["frames"], drawn["damaged_share"])
    session, news = MspSession(1, 1, 1, bounded=False), 0
    for time_s, chunk in enumerate(chunks(stream, drawn["chunk"])):
        session.requests(0, urgent=True, steady_s=time_s)
        session.frame([1500] * 8, time_s)
        found = session.receive(chunk, time_s, time_s)
        assert found <= set(REQUESTS)
        news += len(found)
    count("msp", drawn["frames"], news)


@budget(0.3, STREAM / FRAMES_PER_INPUT)
@given(STREAMS)
def test_any_stream_is_answered_by_the_simulated_firmware(drawn):
    codes = (*ANSWERS, 7, 255)
    whole, stream = drawn_stream(drawn["seed"], drawn["frames"], drawn["damaged_share"], codes, (msp.REQUEST,))
    server, parser, answers = MspServer(RIG.controller), msp.Parser(), 0
    for chunk in chunks(stream, drawn["chunk"]):
        answers += len(parser.feed(server.feed(chunk)))
    RIG.tick()
    assert parser.bad == 0
    if drawn["damaged_share"] == 0.0:
        assert answers <= len(whole)
    count("msp", drawn["frames"], answers)


@budget(0.05)
@given(st.sampled_from(RECORDS + DECODERS + LISTS), st.binary(max_size=80))
def test_a_payload_is_decoded_or_refused(kind, payload):
    decode = kind if kind in DECODERS + LISTS else lambda data: wire.decode(kind, data)
    try:
        decode(payload)
    except wire.PayloadError as error:
        assert str(error).isprintable() and kind not in LISTS
    count("msp", 1)


def asked_of(payloads: dict):
    """Return the function `ask` of a firmware with these payloads, and RIG's for the other codes."""

    def ask(code, payload=b""):
        return payloads[code] if code in payloads else RIG.ask(code, payload)

    return ask


@budget(0.05)
@given(
    st.dictionaries(
        st.sampled_from([code for code in Code if code in ANSWERS and code != Code.SET_RAW_RC]),
        st.one_of(st.none(), edits(2), st.binary(max_size=40)),
        min_size=1,
        max_size=4,
    )
)
@example({Code.BOXIDS: bytes(range(32))})
@example({Code.FC_VARIANT: b"\0TFL"})
@example({Code.MODE_RANGES: bytes([read_back.ARM, 16, 30, 48, read_back.ANGLE, 1, 30, 48])})  # AUX17
@example({Code.RX_MAP: bytes([11, *range(1, 11), 0])})  # more channels than a frame has
def test_any_configuration_of_a_flight_controller_is_used_or_refused(changes):
    payloads = {
        code: edited(RIG.ask(code, b""), change) if isinstance(change, list) else change
        for code, change in changes.items()
    }

    def configured():
        found = read_back.read_back(asked_of(payloads))
        for receiver in RECEIVERS:
            read_back.check(found, RIG.vehicle, receiver, 0.5)
            read_back.describe(found, receiver)
            frame = read_back.FrameComposer(found, receiver).channels([1500] * 3, 1000, arm=True, angle=True)
            wire.encode_channels(frame)
        return found

    found = result_or_refusal(configured)
    assert isinstance(found, read_back.ReadBack | UsageError)
    count("msp", len(changes))


def test_headers_that_claim_long_frames_do_not_slow_the_parser_down():
    parser, begin_s = msp.Parser(), time.process_time()
    stream = b"$X<\0\1\0\xff\x0f" + b"$X<\0\1\0\0\x01" * 2000
    for chunk in chunks(stream, 64):
        parser.feed(chunk)
    assert time.process_time() - begin_s < 2.0


def test_the_unmodified_configuration_is_read():
    found = read_back.read_back(asked_of({}))
    assert found.variant == "BTFL" and found.api == (1, 46)
