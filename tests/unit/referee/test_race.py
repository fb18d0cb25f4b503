"""The referee's races: as long as the physics lets them be, and as long again with an equation that is the law."""

import numpy as np
import pytest
from referee_story import answer, report

from swift_sim_bridge.referee import race, scoring, summary
from swift_sim_bridge.referee.simulator import vehicles

SIDE_FORCE = 0.5  # N/(m/s), of the law `cross_drag`
WIDE = [-100.0, 100.0]


@pytest.fixture(scope="module")
def raced() -> dict:
    """Return the race times (s) of one vehicle in five worlds."""
    file = race.raceable(vehicles.draw_vehicle(np.random.default_rng(4), "test"))
    products = {
        "force_x": {"v_y": {"coefficient": -SIDE_FORCE, "range": WIDE}},
        "force_y": {"v_x": {"coefficient": -SIDE_FORCE, "range": WIDE}},
    }
    worlds = {
        "file": file,
        "law": file | {"strange": {"cross_drag": SIDE_FORCE}},
        "repaired": file | {"terms": file["terms"] | {"equation": products}},
        "weak pack": file | {"battery": file["battery"] | {"resistance": 0.03}},
        "three rotors": file | {"terms": file["terms"] | {"rotor_gain": {"gain": [-0.9, 0.0, 0.0, 0.0]}}},
    }
    return dict(zip(worlds, race.race_times(list(worlds.values()), file), strict=True))


@pytest.mark.slow
def test_a_race_is_as_long_as_the_physics_lets_it_be(raced):
    assert 19.0 < raced["file"] < 24.0
    assert raced["weak pack"] > raced["file"] + 0.3
    assert raced["three rotors"] is None


@pytest.mark.slow
def test_an_equation_that_is_the_concealed_law_gives_the_race_of_the_concealed_world(raced):
    assert abs(raced["law"] - raced["file"]) > 0.05
    assert raced["repaired"] == pytest.approx(raced["law"], abs=0.011)


@pytest.mark.parametrize(
    ("file", "repaired", "concealed", "counted"),
    [
        (22.0, 21.1, 21.0, {"repaired": (1, 1), "file": (0, 1)}),
        (21.0, None, 21.0, {"repaired": (0, 1), "file": (1, 1)}),
        (21.0, 21.0, None, {"repaired": (0, 0), "file": (0, 0)}),
    ],
)
def test_races_of_worlds_are_compared_where_the_concealed_one_is_finished(file, repaired, concealed, counted):
    record = scoring.score(answer("lift", family="strange_race"), report())
    record |= {"race_s": {"file": file, "repaired": repaired, "concealed": concealed}}
    rates = [rate for rate in summary.summarise([record], "own")["rates"] if "race in the" in rate["name"]]
    assert [(rate["hits"], rate["count"]) for rate in rates] == [counted["repaired"], counted["file"]]
