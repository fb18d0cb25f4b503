"""The shortest way through the openings of a track."""

import numpy as np
import pytest
from changed_files import CONFIG, LEVEL, changed, gates

from swift_ros import configuration
from swift_ros.plausibility import shortest_way
from swift_ros.track import Track


@pytest.mark.parametrize(("side", "laps"), [(1.0, 1), (1.0, 4), (0.4, 4), (1.0, 40)])
def test_the_shortest_way_leads_along_the_rims_of_openings(tmp_path, side, laps):
    """Two gates stand side by side, 3 m apart, and the podium beside them: all ways are on one line."""
    changes = {
        "start": [0.0, 5.0, 2.0],
        "laps": laps,
        "gates": gates((0.0, 0.0, 2.0, 0.0), (0.0, -3.0, 2.0, 0.0)),
        "inner_side": side,
        "outer_side": side + 0.2,
    }
    track = configuration.load(Track, changed(tmp_path, "track", changes))
    there, between = 8.0 - 0.5 * side, 3.0 - side
    np.testing.assert_allclose(shortest_way.shortest_m(track), there + (2 * laps - 1) * between, atol=0.02)


def test_a_gate_that_is_flown_again_and_again_needs_only_the_way_to_it(tmp_path):
    track = configuration.load(Track, changed(tmp_path, "track", {"start": [-5.0, 0.0, 2.0], "gates": gates(LEVEL)}))
    np.testing.assert_allclose(shortest_way.shortest_m(track), 5.0, atol=0.02)


def test_no_way_through_the_openings_is_shorter_than_the_shortest():
    track = configuration.load(Track, CONFIG / "track.yaml")
    order = np.arange(track.passages) % len(track.gates)
    draws, reached = np.random.default_rng(1), np.inf
    places = np.zeros((len(order), 2))
    for scale in np.geomspace(0.5, 0.01, 4000):  # a search at random
        tried = np.clip(places + draws.normal(0.0, scale, places.shape), -0.75, 0.75)
        points = track.positions[order] + np.einsum("nij,nj->ni", track.rotations[order][:, :, 1:], tried)
        length = np.linalg.norm(np.diff(np.vstack([track.start, points]), axis=0), axis=1).sum()
        places, reached = (tried, length) if length < reached else (places, reached)
    assert 0.0 <= reached - shortest_way.shortest_m(track) < 5.0
