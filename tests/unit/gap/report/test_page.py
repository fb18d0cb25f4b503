"""The page of a report in a browser: legible on a desk and on a phone, in the order in which one acts on it."""

import browser
import pytest
from report_example import FINDING, PARAMETERS, REPORT, equation, holdout, mismatch, term

from swift_sim_bridge.gap.report import figures
from swift_sim_bridge.gap.report.html import html_page

LONG = "swiftros gap recordings/a/very/long/path/to/the-folder/with-the-bag/bag NEW_FLIGHT --vehicle drone.yaml"
SLOW = "This shift of 1.2 ms is shorter than a row of the recording (10 ms)."
STEPS = [
    {"kind": "use", "text": "Use `vehicle.yaml`.", "commands": ["swiftros race --vehicle runs/gap/vehicle.yaml", LONG]},
    {"kind": "fly", "text": "Punch the throttle.", "commands": []},
]
SIZES = {"desk": (1280, 900), "phone": (390, 844), "small phone": (320, 640)}


@pytest.fixture(scope="module")
def address(tmp_path_factory):
    """Write the page of a report with two names and a long equation, and return its address."""
    folder = tmp_path_factory.mktemp("report")
    delay = FINDING | {"effect": "time_offset", "verdict": "tentative", "alternatives": []}
    delay |= {"removes": 0.7, "caution": SLOW}
    terms = [
        term("specific_force_x", f"omega_{axis} v_x within 0.8 m of (1.0, 2.0, 1.1)", 0.1, "s", 0.1) for axis in "xyz"
    ]
    terms += [term("gyro_y", f"rate of modelled force {axis}", -2e-7, "rad s^2/m", 0.01) for axis in "xyz"]
    report = REPORT | {"findings": [FINDING, delay, equation(*terms)], "next_steps": STEPS}
    pictures = figures.draw((mismatch(),), holdout(), folder)
    (folder / "report.html").write_text(html_page(report, "drone.yaml", PARAMETERS, pictures, folder))
    for picture in folder.glob("*.png"):
        picture.unlink()  # the page needs no other file
    return (folder / "report.html").as_uri()


@pytest.mark.parametrize("size", SIZES)
def test_nothing_is_wider_than_the_window_and_every_picture_is_there(address, size):
    with browser.opened(address, *SIZES[size]) as page:
        page.evaluate("document.querySelectorAll('details').forEach(one => { one.open = true; })")
        assert page.evaluate("document.documentElement.scrollWidth <= window.innerWidth")
        wider = """[...document.querySelectorAll('main *')].filter(
            one => one.getBoundingClientRect().right > window.innerWidth + 0.5
            || (one.scrollWidth > one.clientWidth + 1 && getComputedStyle(one).display !== 'inline')
        ).map(one => one.outerHTML.slice(0, 80))"""
        assert page.evaluate(wider) == []
        images = page.evaluate("[...document.images].map(one => one.complete && one.naturalWidth)")
        assert len(images) >= 6 and min(images) > 800  # px: sharp on a phone, too


def test_the_page_says_first_what_to_do_then_what_removes_most(address):
    with browser.opened(address, *SIZES["phone"]) as page:
        places = [page.locator(f"text={text}").first.bounding_box()["y"] for text in ("Punch the throttle.", SLOW)]
        titles = page.locator("h3").all_inner_texts()
        assert titles == ["time offset", "rotor drag", "unknown physics"]
        places += [page.locator("h3", has_text="rotor drag").bounding_box()["y"]]
        assert places == sorted(places)
        change = page.locator(".value", has_text="terms.rotor_drag.k_d").first.inner_text()
        assert "4.00 · 10−5 → 6.00 · 10−5 N/(rad/s m/s)" in change and "95\N{NO-BREAK SPACE}%: 5.90" in change


def test_a_number_and_its_unit_stand_on_one_line(address):
    with browser.opened(address, *SIZES["phone"]) as page:
        text = page.evaluate("document.querySelector('main').textContent")
    assert (
        "1.2\N{NO-BREAK SPACE}ms" in text and "(70\N{NO-BREAK SPACE}%)" in text and "0.62\N{NO-BREAK SPACE}m/s" in text
    )


def test_text_on_a_phone_is_large_enough_to_read(address):
    smallest = """Math.min(...[...document.querySelectorAll('main *')]
        .filter(one => [...one.childNodes].some(node => node.nodeType === 3 && node.textContent.trim()))
        .filter(one => !one.closest('sub, sup'))
        .map(one => parseFloat(getComputedStyle(one).fontSize)))"""
    with browser.opened(address, *SIZES["phone"]) as page:
        assert page.evaluate(smallest) >= 12.0  # px
