"""The report in the terminal and as a page: the missing effects, where they are visible, and the errors."""

from pathlib import Path

import numpy as np
import pytest
from report_example import (
    DRAWN_CHANNELS,
    FINDING,
    PARAMETERS,
    REPORT,
    TIMES,
    T,
    equation,
    holdout,
    mismatch,
    term,
)

from swift_sim_bridge.gap.report import figures, sentences
from swift_sim_bridge.gap.report.html import NO_BREAK, html_page
from swift_sim_bridge.gap.report.terminal import terminal_text
from swift_sim_bridge.gap.validation.holdout import HoldoutResult

TENTATIVE = FINDING | {"verdict": "tentative", "alternatives": []}


def page(report: dict, pictures=None, folder=Path()) -> str:
    """Return the page of a report with plain spaces before its units."""
    return html_page(report, "drone.yaml", PARAMETERS, pictures or {}, folder).replace(NO_BREAK, " ")


def test_the_mismatch_is_located_in_layer_and_time_in_multiples_of_the_noise():
    one = mismatch()
    layers = one.layers(one.before)
    assert list(layers) == ["motor", "battery", "force", "imu"]
    wrong = (T > 8.5) & (T < 11.5)
    assert np.nanmean(layers["force"][wrong]) == pytest.approx(TIMES, rel=0.05)
    assert np.nanmean(layers["force"][~wrong & (T < 7.5)]) == pytest.approx(1.0, abs=0.1)
    assert np.nanmax(layers["motor"]) < 2.5 and np.nanmax(one.worst(one.after)) < 2.5
    assert np.isnan(one.worst(one.before)[(T > 3.05) & (T < 3.35)]).all()


def test_the_page_describes_the_missing_effect_and_holds_every_picture(tmp_path):
    pictures = figures.draw((mismatch(),), holdout(), tmp_path)
    curves = [f"curves_{channel.id}.png" for channel in DRAWN_CHANNELS if channel.id == "specific_force_x"]
    expected = ["track_before.png", "time_after.png", "rollouts.png", "horizons.png", *curves]
    assert set(expected) <= set(pictures)
    assert all((tmp_path / name).stat().st_size > 10_000 for name in pictures)
    html = page(REPORT, pictures, tmp_path)
    assert html.count("data:image/png;base64,") == len(pictures)
    texts = (
        "rotor drag",
        "The rotors drag.",
        "cannot distinguish it (70 %) from: damaged propeller 2 (30 %); none is clearly likelier.",
        "one speed at two thrusts",
        "0.21 →</span> <span class=is>0.010 m",
        "<th>repaired</th>",
        "<td>rotor 1 speed [rad/s]</td><td>40</td><td>39</td>",
        "Errors on the unseen flight later flight.csv",
        "<td>specific force y, body [m/s<sup>2</sup>]</td><td>1.3</td><td>0.41</td><td>0.32</td><td>0.62</td>",
        "6.00 · 10<sup>−5</sup> N/(rad/s m/s)",
        "terms.rotor_drag.k_d",
        "removes 20 % of the error",
        "specific force x: 0.62 m/s<sup>2</sup> without it, 0.31 m/s<sup>2</sup> with it",
        "drone.yaml",
        "flight.csv, 3.00 s to 3.50 s, gyro: stood still",
        "mass: 4.0 g<",
        "<td>mass</td><td>tentative</td>",
        "nothing &lt;to&gt; blow at",
    )
    assert not [text for text in texts if text not in html]


def test_the_terminal_compares_the_models_on_an_unseen_flight_by_axis():
    lines = terminal_text(REPORT).splitlines()
    (head,) = (i for i, line in enumerate(lines) if line.startswith("specific force, m/s^2"))
    cells = [cell for error in ("1.300", "0.410", "0.320", "0.620", "0.530") for cell in (error, f"({error})")]
    assert [line.split()[-11:] for line in lines[head + 1 : head + 4]] == [[axis, *cells] for axis in "xyz"]


@pytest.mark.parametrize(
    ("sigma", "text"),
    [
        (21.4, "21 standard deviations"),
        (1.4, "not significant beside the others"),
        (-0.2, "not significant beside the others"),
    ],
)
def test_a_name_that_others_imitate_has_no_negative_significance(sigma, text):
    first, *others = REPORT["findings"]
    report = REPORT | {"findings": [{**first, "significance_sigma": sigma}, *others]}
    assert text in terminal_text(report) and "-0 " not in terminal_text(report)


def test_an_error_that_the_repair_does_not_change_is_no_improvement():
    unchanged = {**REPORT["improvement"]["held_out"], "one_step_rmse": {"before": 0.151, "after": 0.150}}
    unchanged["rollout_rmse_m"] = {
        "0.5": {"before": 0.0061, "after": 0.0061, "with_remainder": 0.006, "knn": 0.01, "gp": 0.01}
    }
    (sentence,) = sentences.improvements(REPORT | {"improvement": {"held_out": unchanged, "left": {}}})
    assert sentence == (
        "On parts of the flights that no fit has used, the error of voltage changes from 0.31 V to 0.02 V."
    )


def test_several_flights_without_findings_are_drawn_also_if_one_has_no_pose(tmp_path):
    pictures = figures.draw(
        (mismatch(repaired=False), mismatch(repaired=False, p_world=False)), HoldoutResult(), tmp_path
    )
    whole = [name for name in pictures if not name.startswith("curves")]
    assert whole == ["track_before_1.png", "time_before_1.png", "time_before_2.png"]
    assert {name.rpartition("_")[2] for name in pictures if name.startswith("curves")} == {"1.png", "2.png"}


@pytest.mark.parametrize(
    "time, regime, expected",
    [
        ([[0.0, 20.0]], "", "throughout"),
        ([[0.0, 20.0]], "most where the speed is above 8 m/s", "most where the speed is above 8 m/s"),
        ([[12.0, 13.0]], "", "at 12.0 to 13.0 s"),
        ([[0.0, 20.0], [4.0, 5.0], [12.0, 13.0]], "", "at 4.0 to 5.0 s, 12.0 to 13.0 s"),
    ],
)
def test_the_report_states_when_a_finding_is_visible(time, regime, expected):
    finding = FINDING | {"where": {"time": time, "segments": [], "regime": regime}}
    report = REPORT | {"findings": [finding], "flights": [[0.0, 20.0], [0.0, 30.0]]}
    assert f"  where: {expected}\n" in terminal_text(report)
    assert f"Seen {expected};" in page(report)


def test_the_headline_names_confirmed_and_probable_effects():
    confirmed = FINDING | {"verdict": "confirmed", "effect": "mass"}
    headline = sentences.headline(REPORT | {"findings": [FINDING, confirmed]})
    assert headline == (
        "The simulation lacks an effect, and several effects could explain it. Confirmed: mass. "
        "Probable: either rotor drag (70 %) or damaged propeller 2 (30 %) (none clearly likelier)."
    )
    findings = [TENTATIVE, TENTATIVE | {"effect": "accel_bias"}]
    assert sentences.headline({"verdict": "tentative", "findings": findings}) == (
        "The simulation lacks an effect, which is identified with low confidence. Probable: rotor drag and accel bias."
    )


def test_the_likeliest_of_a_set_comes_first_with_all_weights():
    clear = [one | {"weight": weight} for one, weight in zip(FINDING["alternatives"], (0.95, 0.05), strict=True)]
    report = REPORT | {"findings": [FINDING | {"alternatives": clear}]}
    assert "Probable: either rotor drag (95 %) or damaged propeller 2 (5.0 %)." in sentences.headline(report)
    sentence = "The likeliest (95 %); these recordings cannot distinguish it from: damaged propeller 2 (5.0 %)."
    assert f"  {sentence} To separate them: one speed at two thrusts\n" in terminal_text(report)
    assert sentence in page(report)


def test_an_equation_is_printed_with_its_terms_and_their_units_those_first_that_remove_most():
    finding = equation(term("voltage", "1", 0.5, "V", 0.04), term("specific_force_x", "|v| v_x", -0.01, "1/m", 0.62))
    lines = terminal_text(REPORT | {"verdict": "unknown", "findings": [finding]}).splitlines()
    terms = [line for line in lines if "of its error" in line]
    assert terms == [
        "  specific force x: -0.0100 1/m (-0.0090 .. -0.0110) times |v| v_x; removes 62 % of its error",
        "  voltage: 0.500 V (0.450 .. 0.550); removes 4.0 % of its error",
    ]


def test_the_smaller_terms_of_a_long_equation_are_folded_and_a_ratio_has_no_unit():
    terms = [term("specific_force_x", f"omega_{axis} v_{other}", 0.1, "", 0.1) for axis in "xyz" for other in "xyz"]
    finding = equation(*terms, term("voltage", "Omega'", 1.0, "V s", 0.9))
    html = page(REPORT | {"findings": [finding]})
    shown, folded = html[html.index("unknown physics") :].split("<summary>6 smaller terms</summary>")
    assert shown.index("Ω′") < shown.index("ω<sub>x</sub> v<sub>x</sub>")
    assert "ω<sub>z</sub> v<sub>z</sub>" in folded and "0.100 · ω" in folded
    assert "()" not in html and "[]" not in html and "[1]" not in html


@pytest.mark.parametrize(
    ("equation", "explained", "absent"),
    [
        ("T_i (1 - loss)", "T: thrust", "m_p, r: its mass and place"),
        ("J = J_0 + (r^2 1 - r r^T) M m_p / m", "m_p, r: its mass and place", "T: thrust"),
    ],
    ids=["thrust", "transposed"],
)
def test_the_page_explains_the_symbols_of_an_equation(equation, explained, absent):
    """The T of a transposed vector is no thrust."""
    html = page(REPORT | {"findings": [TENTATIVE | {"equation": equation}]})
    assert explained in html and absent not in html


def test_findings_stand_in_the_order_of_the_error_that_they_remove():
    small, large = (TENTATIVE | {"effect": name, "removes": share} for name, share in (("wind", 0.001), ("mass", 0.7)))
    report = REPORT | {"findings": [small, FINDING, large]}
    html, text = page(report), terminal_text(report)
    for names in (["<h3>mass", "<h3>rotor drag", "<h3>wind"], ["tentative: mass", "ambiguous: rotor drag"]):
        places = [(html if name.startswith("<") else text).index(name) for name in names]
        assert places == sorted(places)


def test_a_change_beyond_the_physical_range_is_not_listed_as_detectable():
    found = {"ground_effect": {"k": 3767.0}, "mass": {"mass": 0.004}}
    html = page(REPORT | {"minimum_detectable": found})
    assert "k: no physical change" in html and "mass: 4.0 g" in html
