"""Tracks that nobody can race on are refused by a sentence each; odd but possible ones are used.

A case is a change of the shipped file: keys joined by dots, and the new value.
"""

import pytest
from changed_files import LEVEL, changed, gates
from file_checks import check_acceptance, check_advice, check_refusal

from swift_ros.track import Track

IMPOSSIBLE = [
    ({"gates": gates((0.0, 0.0, 0.5, 0.0))}, "gate 1 reaches 0.25 m into the ground"),
    ({"gates": gates((0.0, 0.0, -3.0, 0.0))}, "into the ground"),
    ({"gates": gates((14.9, 0.0, 2.0, 0.0), (40.0, 0.0, 2.0, 0.0))}, "gate 2 is not within the flight volume"),
    ({"gates": gates((0.0, 0.0, 7.6, 0.0))}, "frame of gate 1 reaches 0.65 m into the ceiling"),
    ({"gates": gates((0.0, 0.0, 7.2, 0.0), LEVEL)}, "frame of gate 1 reaches 0.25 m into the ceiling"),
    ({"gates": gates((0.0, 14.5, 2.0, 0.0))}, "frame of gate 1 reaches 0.55 m into a wall"),
    (
        {"gates": gates((0.0, 14.1, 2.0, 0.0), (0.0, -14.2, 2.0, 0.0))},
        "frames of gates 1 and 2 reach up to 0.25 m into a wall",
    ),
    (
        {"gates": gates(LEVEL, (40.0, 0.0, 2.0, 0.0), (0.0, 40.0, 2.0, 0.0))},
        "gates 2 and 3 are not within the flight volume",
    ),
    (
        {"gates": gates((0.0, 0.0, 1.2, 0.0, {"roll_deg": 45.0}))},
        "frame of gate 1 reaches 0.07 m into the ground",
    ),
    ({"gates": gates(LEVEL, (0.0, 0.0, 2.0, 3.0))}, "the frames of gates 1 and 2 overlap"),
    ({"gates": gates(LEVEL, (0.0, 0.0, 2.0, 0.0, {"roll_deg": 30.0}))}, "the frames of gates 1 and 2 overlap"),
    (
        {"gates": gates(LEVEL, (5.0, 0.0, 2.0, 0.0), (0.0, 0.0, 2.0, 0.0, {"inner_side": 0.8, "outer_side": 1.0}))},
        "the frames of gates 1 and 3 overlap",
    ),
    ({"gates": gates(LEVEL, LEVEL, (5.0, 0.0, 2.0, 0.0))}, "gates 1 and 2 follow each other at one place"),
    ({"gates": gates(LEVEL, (0.3, 0.0, 2.0, 45.0))}, "the frames of gates 1 and 2 overlap"),
    ({"gates": gates(LEVEL, (0.0, 0.0, 2.0, 90.0))}, "the frames of gates 1 and 2 overlap"),
    ({"gates": []}, "no gates"),
    ({"inner_side": 2.2}, "track.yaml: 'inner_side' 2.2 m must be .* less than 'outer_side' 2.1 m; exchange"),
    ({"inner_side": -1.5}, "positive"),
    ({"inner_side": 1500.0, "outer_side": 2100.0}, "a frame is 2100 m large; give 'inner_side'"),
    (
        {"gates": gates((500.0, 0.0, 2.0, 0.0), (900.0, 0.0, 2.0, 0.0))},
        "all gates are outside of the flight volume",
    ),
    ({"gates": gates(LEVEL, (0.0, 0.8, 2.0, 0.0))}, "0.80 m apart, and a bar of one is in the opening"),
    ({"gates": gates(LEVEL, (0.0, 1.9, 2.0, 0.0))}, "1.90 m apart; correct .* or let them share a bar"),
    (
        {"gates": gates(LEVEL, (0.6, 0.0, 2.5, 0.0, {"pitch_deg": 90.0}))},
        "the frames of gates 1 and 2 overlap",
    ),
    ({"gates": gates(LEVEL, (0.0, 1.6, 2.0, 0.0, {"roll_deg": 45.0}))}, "the frames of gates 1 and 2 overlap"),
    (
        {"gates": gates(LEVEL, (0.0, 2.5, 2.0, 0.0, {"inner_side": 3.0, "outer_side": 3.4}))},
        "the frames of gates 1 and 2 overlap",
    ),
    ({"start": [0.0, 0.9, 2.0], "gates": gates(LEVEL)}, "'start' is within the frame of gate 1"),
    ({"gates": gates((0.0, 0.0, 0.1, 0.0, {"pitch_deg": 90.0}))}, "no room: the ground"),
    ({"gates": gates((14.8, 0.0, 2.0, 0.0))}, "no room: a wall"),
    (
        {"gates": gates((0.0, 0.0, 2.0, 0.1), (5.0, 5.0, 2.0, 1.57), (0.0, 10.0, 2.0, 3.1), (-5.0, 5.0, 2.0, -1.57))},
        "as radians",
    ),
    (
        {"gates": gates((*LEVEL, {"inner_side": 3.0}))},
        "gate 1: 'inner_side' 3 m must be .* 'outer_side' 2.1 m; give this gate both",
    ),
    ({"gates": gates((0.0, 0.0, 0.8, 0.0, {"roll_deg": 45.0}))}, "into the ground"),
    (
        {"gates": gates((0.0, 0.0, -3.6, 0.0), (5.0, 0.0, -1.0, 0.0))},
        "all gates are below the ground, the highest at z -1 m, and z is up; change the sign of each z",
    ),
    (
        {"start": [-5.0, 4.5, -1.2], "gates": gates((0.0, 0.0, -30.0, 0.0), (5.0, 0.0, -20.0, 0.0))},
        "all gates are below the ground, .*; raise each 'position', or correct 'bounds_min'",
    ),
    ({"gates": gates(LEVEL, (0.0, 0.0, 3.5, 0.0))}, "1.50 m apart, and a bar of one is in the opening"),
    ({"depth": 0.0}, "'depth' must be positive"),
    ({"start": [-5.0, 45.0, 1.2]}, "'start' is outside"),
    ({"start": [-5.0, 4.5, -1.2]}, "'start' is outside"),
    ({"laps": 0}, "at least 1"),
    ({"bounds_min": [15.0, -15.0, 0.0]}, "'bounds_min' .15.0, -15.0, 0.0. must be less than .*; give the low"),
    ({"bounds_min": [15.0, 15.0, 8.0], "bounds_max": [-15.0, -15.0, 0.0]}, "along each axis; exchange them"),
]
POSSIBLE = [
    ({"gates": gates(LEVEL, (0.0, 1.8, 2.0, 0.0))}),
    ({"gates": gates(LEVEL, (0.0, 0.0, 4.1, 0.0))}),
    ({"gates": gates((0.0, 0.0, 1.05, 0.0), (0.0, 0.0, 2.85, 180.0), (5.0, 0.0, 2.0, 0.0))}),
    ({"gates": gates((0.0, 0.0, 0.76, 0.0), (0.0, 0.0, 2.87, 180.0), (5.0, 0.0, 2.0, 0.0))}),
    ({"gates": gates(LEVEL, (0.0, 0.0, 2.0, 180.0))}),
    ({"gates": gates((0.0, 13.95, 6.95, 0.0))}),
    ({"gates": gates(LEVEL, (0.9, 0.9, 2.0, 90.0))}),
    ({"gates": gates(LEVEL, (8.0, 0.0, 2.0, 2.0), (10.0, 0.3, 2.0, 1.5))}),
    ({"gates": gates((0.0, 0.0, 0.75, 0.0))}),
    ({"gates": gates(LEVEL)}),
    ({"gates": gates(LEVEL, (5.0, 0.0, 2.0, 0.0), (0.0, 0.0, 2.0, 180.0), (5.0, 0.0, 2.0, 180.0))}),
    ({"gates": gates(LEVEL, (5.0, 0.0, 2.0, 0.0), LEVEL, (0.0, 6.0, 2.0, 0.0))}),
    ({"gates": gates((0.0, 0.0, 3.0, 0.0, {"pitch_deg": 90.0}), (5.0, 0.0, 2.0, 0.0))}),
    ({"gates": gates((*LEVEL, {"inner_side": 0.8, "outer_side": 1.0}), (5.0, 0.0, 2.0, 0.0))}),
    ({"start_yaw_deg": 140.0}),
    ({"laps": 50}),
]
ODD = [
    ({"gates": gates((*LEVEL, {"roll_deg": 45.0}))}, "the detector confuses its corners"),
    ({"gates": gates((*LEVEL, {"pitch_deg": 80.0}))}, "rarely finds it"),
    ({"start_yaw_deg": 140.0}, "away from gate 1"),
    (
        {"inner_side": 0.39},
        "the opening of gates 1, 2, 3, 4, 5, 6 and 7 is 0.39 m wide; gates have 0.4 to 4 m",
    ),
    ({"gates": gates(LEVEL, (0.0, 0.0, 2.0, 180.0))}, "gates 1 and 2 are one frame that is flown there"),
]


@pytest.mark.parametrize(("changes", "sentence"), IMPOSSIBLE)
def test_an_impossible_track_is_refused_by_one_sentence(tmp_path, changes, sentence):
    check_refusal(Track, changed(tmp_path, "track", changes), sentence)


@pytest.mark.parametrize("changes", POSSIBLE)
def test_an_odd_track_is_accepted(tmp_path, changes):
    check_acceptance(Track, changed(tmp_path, "track", changes))


@pytest.mark.parametrize(("changes", "sentence"), ODD)
def test_what_is_odd_of_a_track_is_said(tmp_path, capsys, changes, sentence):
    check_advice(changed(tmp_path, "track", changes), sentence, capsys)
