"""The labelling page: what it shows, what a person can do on it, what is written when, and who may ask for it."""

import http.client
import json
import threading
from contextlib import contextmanager
from dataclasses import replace

import cv2
import numpy as np
import pytest
from labelling_person import GOOD_PX, Work, correct, drag, gates_on, on_screen, opened_page

from swift_ros import cli
from swift_ros.errors import UsageError
from swift_sim_bridge.labelling import clicks, frames
from swift_sim_bridge.labelling.proposals import DETECTOR, TRACKED, Proposal
from swift_sim_bridge.labelling.server import LabellingServer
from swift_sim_bridge.labelling.session import Session
from swift_sim_bridge.labels import folder
from swift_sim_bridge.labels.labelled_images import PERSON, LabelledGate

SQUARE = np.array([[100.0, 50.0], [180.0, 52.0], [182.0, 131.5], [99.25, 130.0]])
STEP = np.array([12.0, 3.0])  # px, movement of the gate from image to image
IMAGES = 4


def gate(corners=SQUARE) -> LabelledGate:
    return LabelledGate(np.array(corners), np.full(4, 2))


class PlannedProposer:
    """Proposes the gate with one corner that is off, and one gate that is not there; then the gate of the former image.

    It stands in for detector and tracking, which have tests of their own.
    """

    def __init__(self, found):
        self.frames = found

    def propose(self, image, before):
        number = self.frames.images.index(image)
        if before is not None:
            return [Proposal(gate(one.corners_px + STEP), TRACKED) for one in before.gates]
        off = SQUARE + number * STEP
        off[1] += [6.0, -4.0]
        return [Proposal(gate(off), DETECTOR), Proposal(gate(SQUARE * 0.3 + 200.0), DETECTOR)]


@pytest.fixture
def images(tmp_path):
    """Return a folder with images of a white gate on black."""
    for number in range(IMAGES):
        pixels = np.zeros((240, 320, 3), np.uint8)
        cv2.polylines(pixels, [np.rint(SQUARE + number * STEP).astype(int)], True, (40, 160, 255), 2)
        cv2.imwrite(str(tmp_path / f"{number}.png"), pixels)
    return tmp_path


@contextmanager
def served(path):
    """Yield a server of the images of a folder."""
    server = LabellingServer(Session(PlannedProposer(frames.of_folder(path, 80.0))), 0)
    thread = threading.Thread(target=server.serve_forever, daemon=True)
    thread.start()
    try:
        yield server
    finally:
        server.shutdown()
        server.server_close()
        thread.join()


@pytest.fixture
def server(images):
    with served(images) as started:
        yield started


def ask(server, method: str, path: str, body=None, **headers):
    """Return (status, content) of a request."""
    connection = http.client.HTTPConnection(*server.server_address, timeout=30)
    given = {"Content-Type": "application/json"} | {name.replace("_", "-"): value for name, value in headers.items()}
    connection.request(method, path, body if isinstance(body, bytes | None) else json.dumps(body), given)
    answer = connection.getresponse()
    content = answer.read()
    connection.close()
    return answer.status, json.loads(content) if "json" in answer.headers["Content-Type"] else content


def sent(corners=SQUARE, **values) -> dict:
    row = {"corners": np.asarray(corners).tolist(), "visibility": [2, 2, 2, 2], "proposal": 0}
    return {"gates": [row], "all_gates": True, "seconds": 3.0, "actions": []} | values


def test_an_accepted_frame_is_written_at_once_and_the_next_one_is_tracked(server, images):
    assert [one["origin"] for one in ask(server, "GET", "/frame/1")[1]["gates"]] == [DETECTOR, DETECTOR]
    ask(server, "GET", "/frame/0")
    status, overview = ask(server, "POST", "/frame/0", sent())
    assert (status, overview["labelled"]) == (200, [True, False, False, False])
    written = folder.read(images, 80.0).images
    assert [image.file_name for image in written] == ["0.png"] and written[0].source == PERSON
    assert np.allclose(written[0].gates[0].corners_px, SQUARE)
    (proposed,) = ask(server, "GET", "/frame/1")[1]["gates"]
    assert proposed["origin"] == TRACKED
    row = json.loads((images / clicks.CLICKS).read_text())
    assert row["image"] == "0.png" and row["seconds"] == 3.0
    expected = {"proposed": 2, "unchanged": 0, "corners_moved": 1, "visibility_changed": 0, "added": 0, "deleted": 1}
    assert row["changes"] == expected


def test_a_new_session_continues_where_the_last_one_ended(images):
    with served(images) as first:
        ask(first, "POST", "/frame/0", sent())
    with served(images) as second:
        assert ask(second, "GET", "/session")[1]["labelled"] == [True, False, False, False]
        shown = ask(second, "GET", "/frame/0")[1]
        assert shown["labelled"] and shown["gates"][0]["origin"] == PERSON


def test_an_import_into_labelled_images_keeps_that_only_some_gates_are_labelled(images):
    partly = replace(frames.of_folder(images, 80.0).images[0], gates=(gate(),), all_gates=False)
    folder.write(images, [partly])
    assert cli.main(["label", str(images), "--fov-deg", "80", "--export", str(images / "gates.xml")]) == 0
    assert cli.main(["label", str(images), "--fov-deg", "80", "--import", str(images / "gates.xml")]) == 0
    (image,) = folder.read(images, 80.0).images
    assert not image.all_gates and len(image.gates) == 1


@pytest.mark.parametrize(
    ("body", "sentence"),
    [
        (sent(SQUARE[::-1]), "0.png: gate 1 has its corners anticlockwise"),
        (sent(SQUARE[[0, 2, 1, 3]]), "cross"),
        (sent(np.full((4, 2), 5000.0)), "outside of the image"),
        (sent(np.full((4, 2), np.nan)), "not a number"),
        (sent([[0, 0]]), "no four corners"),
        (sent(gates=[{"corners": SQUARE.tolist(), "visibility": [2, 2, 2, 9]}]), "visibilities"),
        (sent(gates=[7]), "no four corners"),
        (sent(gates=7), "'gates' must be a list"),
        (sent(all_gates=1), "'all_gates' true or false"),
        (sent(seconds="long"), "'seconds' must be a number"),
        (b"{", "not valid JSON"),
        (b"[]", "not a mapping"),
    ],
)
def test_what_cannot_be_a_label_is_refused_by_a_sentence_and_nothing_is_written(server, images, body, sentence):
    status, content = ask(server, "POST", "/frame/0", body)
    assert status == 400 and sentence in content["error"]
    assert not (images / folder.LABELS).exists()


@pytest.mark.parametrize(
    ("method", "path", "headers", "status"),
    [
        ("GET", "/session", {"Host": "gates.example:8765"}, 403),  # a name that another site made resolve to here
        ("POST", "/frame/0", {"Content_Type": "text/plain"}, 400),  # what a form of another site can send
        ("POST", "/frame/0", {"Content_Length": "99999999"}, 413),
        ("GET", "/../pyproject.toml", {}, 404),
        ("GET", "/frame/99", {}, 400),
        ("GET", "/frame/x", {}, 400),
        ("GET", "/picture/99", {}, 400),
    ],
)
def test_foreign_and_wrong_requests_are_refused(server, method, path, headers, status):
    answer, content = ask(server, method, path, sent() if method == "POST" else None, **headers)
    assert answer == status and content["error"]


def test_a_port_in_use_meets_a_sentence(server, images):
    session = Session(PlannedProposer(frames.of_folder(images, 80.0)))
    with pytest.raises(UsageError, match=r"TCP port \d+ is not available: .*; choose another --port"):
        LabellingServer(session, server.server_address[1])


def test_the_summary_counts_pauses_as_a_minute_and_survives_a_torn_line(tmp_path):
    path = tmp_path / clicks.CLICKS
    counts = {"proposed": 2, "unchanged": 1, "corners_moved": 3, "added": 0, "deleted": 1}
    for seconds in (4.0, 5000.0):
        clicks.append(path, {"image": "a.png", "seconds": seconds, "changes": counts})
    path.write_text(path.read_text() + '{"image": "b.p')
    text = clicks.summary(path)
    assert text.startswith("2 images accepted in 1 min 04 s: 2 of 4 proposed gates unchanged, 6 corners moved")
    assert clicks.summary(tmp_path / "none") == ""


def test_a_person_corrects_the_frames_in_the_browser(server, images):
    """The whole page in Chromium: move a corner, delete a gate, accept; later frames are tracked and only accepted."""
    work = Work()
    with opened_page(server.address) as page:
        assert page.text_content("#state") == "proposed"
        assert page.text_content("#count") == f"image 1 of {IMAGES}, 0 labelled"
        assert len(gates_on(page)) == 2 and page.locator("#list li").count() == 2
        for number in range(IMAGES):
            page.wait_for_selector(f"body[data-frame='{number}']")
            correct(page, [gate(SQUARE + number * STEP)], work)
        page.wait_for_selector("#state.done")
        assert page.text_content("#count") == f"image {IMAGES} of {IMAGES}, {IMAGES} labelled"
    for number, image in enumerate(folder.read(images, 80.0).images):
        (found,) = image.gates
        assert np.linalg.norm(found.corners_px - (SQUARE + number * STEP), axis=-1).max() < GOOD_PX
    rows = [json.loads(line) for line in (images / clicks.CLICKS).read_text().splitlines()]
    assert [row["changes"]["corners_moved"] for row in rows] == [1, 0, 0, 0]
    assert [row["changes"]["deleted"] for row in rows] == [1, 0, 0, 0]
    assert [action["what"] for action in rows[0]["actions"]] == ["delete", "drag", "accept"]
    assert (work.frames, work.drags) == (IMAGES, 1)


def test_keys_add_undo_switch_and_refuse_on_the_page(server, images):
    with opened_page(server.address) as page:
        page.keyboard.press("d")
        page.keyboard.press("d")
        assert gates_on(page) == []
        page.keyboard.press("u")
        assert len(gates_on(page)) == 1
        page.keyboard.press("d")
        page.keyboard.press("a")
        for corner in SQUARE[::-1]:  # against the order
            page.mouse.click(*on_screen(page, corner))
        page.keyboard.press("Enter")
        page.wait_for_selector("#message.wrong")
        assert "anticlockwise" in page.text_content("#message")
        assert not (images / folder.LABELS).exists()
        page.keyboard.press("u")
        page.keyboard.press("a")
        for corner in SQUARE:
            page.mouse.click(*on_screen(page, corner))
        page.mouse.click(*on_screen(page, SQUARE[2]))
        page.keyboard.press("o")
        page.mouse.click(*on_screen(page, SQUARE[3]))
        page.keyboard.press("x")
        drag(page, SQUARE[0], SQUARE[0] - 5.0)
        page.keyboard.press("g")
        page.keyboard.press("Enter")
        page.wait_for_selector("body[data-frame='1']")
    (image,) = folder.read(images, 80.0).images
    assert not image.all_gates
    assert image.gates[0].visibility.tolist() == [2, 2, 1, 0]
    assert np.allclose(image.gates[0].corners_px[0], SQUARE[0] - 5.0, atol=0.6)


def test_the_magnifier_shows_the_pixels_under_the_cursor(server):
    with opened_page(server.address) as page:
        page.mouse.move(*on_screen(page, SQUARE[0]))
        page.wait_for_function(
            """() => {
            const magnifier = document.getElementById("magnifier");
            const pixels = magnifier.getContext("2d").getImageData(0, 0, magnifier.width, magnifier.height).data;
            return pixels.some((value, index) => index % 4 === 0 && value === 255)
                && pixels.some((value, index) => index % 4 === 2 && value === 40);
        }"""
        )  # the gate's colour, in red and blue
