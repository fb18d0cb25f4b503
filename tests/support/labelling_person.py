"""A person at the labelling page: knows the true gates, corrects what is off, and needs a modelled time for it.

The time is counted, not slept: LOOK_S to look at a frame, and ACTION_S for each key, click and drag.
"""

from contextlib import contextmanager
from dataclasses import dataclass

import browser
import numpy as np

LOOK_S = 1.5  # s, to see whether the proposals of a frame are right
ACTION_S = 1.2  # s, for a key, a click or a drag of a corner (keystroke-level model: 1.1 s to point, 0.1 s to press)
GOOD_PX = 2.0  # a corner that is nearer to the truth is left as it is
GATE = "g.gate[data-gate='{}']"


@contextmanager
def opened_page(address: str):
    """Yield the labelling page at an address in headless Chromium; skip the test where none is installed."""
    with browser.opened(address, 1280, 800) as page:
        page.wait_for_selector("body[data-frame]")
        yield page


@dataclass
class Work:
    """What the person has done: frames, keys and clicks, drags."""

    frames: int = 0
    keys: int = 0
    drags: int = 0

    @property
    def seconds(self) -> float:
        """Modelled time."""
        return LOOK_S * self.frames + ACTION_S * (self.keys + self.drags)


def gates_on(page) -> list[np.ndarray]:
    """Return the corners (4, 2) px of the gates on the page as drawn; NaN where a corner is not drawn."""
    found = []
    for group in page.query_selector_all("g.gate"):
        corners = np.full((4, 2), np.nan)
        for dot in group.query_selector_all("circle"):
            k = ("TL", "TR", "BR", "BL").index(dot.get_attribute("data-corner"))
            corners[k] = float(dot.get_attribute("cx")), float(dot.get_attribute("cy"))
        found.append(corners)
    return found


def on_screen(page, point) -> tuple[float, float]:
    """Return where a point (2,) px of the image is on the screen."""
    script = """([u, v]) => {
        const at = new DOMPoint(u, v).matrixTransform(document.getElementById("view").getScreenCTM());
        return [at.x, at.y];
    }"""
    return tuple(page.evaluate(script, [float(value) for value in point]))


def drag(page, start, end) -> None:
    """Drag from one point of the image to another."""
    page.mouse.move(*on_screen(page, start))
    page.mouse.down()
    page.mouse.move(*on_screen(page, (np.asarray(start) + end) / 2))
    page.mouse.move(*on_screen(page, end))
    page.mouse.up()


def press(page, key: str, work: Work) -> None:
    page.keyboard.press(key)
    work.keys += 1


def correct(page, truth: list, work: Work) -> None:
    """Correct the gates of the shown frame to the true LabelledGate, and accept."""
    work.frames += 1
    missing = list(truth)
    for index, shown in reversed(list(enumerate(gates_on(page)))):
        match = nearest(shown, missing)
        if match is None:
            page.click(f"#list li:nth-child({index + 1})")
            press(page, "d", work)
            work.keys += 1  # the click
            continue
        missing.remove(match)
        for k in np.nonzero(match.visibility == 2)[0]:
            if np.linalg.norm(shown[k] - match.corners_px[k]) > GOOD_PX:
                drag(page, shown[k], match.corners_px[k])
                work.drags += 1
    for gate in missing:
        if gate.is_whole:  # a person need not label a gate that is cut
            press(page, "a", work)
            for corner in gate.corners_px:
                page.mouse.click(*on_screen(page, corner))
                work.keys += 1
    number = page.get_attribute("body", "data-frame")
    press(page, "Enter", work)
    page.wait_for_function(
        """number => document.body.dataset.frame !== number
        || document.getElementById("state").className.includes("done")""",
        arg=number,
    )


def nearest(shown, gates):
    """Return the true gate whose corners are near those shown; None where there is none."""
    best, best_off = None, np.inf
    for gate in gates:
        off = np.nanmean(np.linalg.norm(gate.corners_px - shown, axis=-1))
        if off < min(best_off, 0.6 * gate.side_px):
            best, best_off = gate, off
    return best
