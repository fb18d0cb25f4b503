"""Which names the repaired vehicle file gets, judged on a part of the flight that no fit has used."""

import jax
import numpy as np
import pytest
from lissajous_flight import REFERENCE_FLIGHTS, flight, vehicle

from swift_ros import geometry
from swift_ros.recording.flight_table import FlightTable, Samples
from swift_sim_bridge.gap.attribution.evidence import SearchResult, SelectedEffect
from swift_sim_bridge.gap.effects.catalogue import catalogue
from swift_sim_bridge.gap.pipeline import prepare, references
from swift_sim_bridge.gap.pipeline.diagnosis import Options
from swift_sim_bridge.gap.validation import repair_choice


def repair_of(recording: FlightTable, found_names: dict, withdrawn: bool):
    """Return (repair, reported effects) where a search has found these effects with their values, or given them up."""
    effects = {effect.key: effect for effect in catalogue(vehicle())}
    names = tuple(
        SelectedEffect(effects[key], np.array(values), np.eye(len(values)), 50.0, is_certain=not withdrawn)
        for key, values in found_names.items()
    )
    with jax.enable_x64(True):
        evidence = prepare.prepare_evidence([recording], vehicle(), Options(lambda text: None))
        found = SearchResult(() if withdrawn else names, (), evidence, names if withdrawn else ())
        chosen = repair_choice.choose_repair(vehicle(), found, lambda text: None)
    return chosen, repair_choice.reported(found, chosen).selected


def test_a_name_of_which_an_equation_explains_more_stays_where_the_unseen_part_gets_better(monkeypatch):
    monkeypatch.setattr(references, "REFERENCE_FLIGHTS", REFERENCE_FLIGHTS)
    chosen, reported = repair_of(flight(3, rotor_drag=[6e-5]), {"rotor_drag": [4e-5]}, withdrawn=True)
    (drag,) = chosen.names
    assert drag.values == pytest.approx([6e-5], rel=0.03) and not chosen.left_out
    assert [(one.effect.id, one.verdict) for one in reported] == [("rotor_drag", "tentative")]


def test_a_name_without_which_the_unseen_part_is_better_is_not_in_the_repair(monkeypatch):
    """The accelerometer is off in the first half of the flight alone: no bias of the whole flight."""
    monkeypatch.setattr(references, "REFERENCE_FLIGHTS", REFERENCE_FLIGHTS)
    table = flight(3)
    t, force = table["specific_force_body"].t, table["specific_force_body"].values.copy()
    force[t < t[0] + 0.5 * (t[-1] - t[0])] += [0.0, 1.5, 0.0]
    changed = FlightTable("shifted", {**table.channels, "specific_force_body": Samples(t, force)})
    chosen, reported = repair_of(changed, {"accel_bias": [0.0, 1.0, 0.0]}, withdrawn=False)
    assert not chosen.names and [one.effect.id for one in chosen.left_out] == ["accel_bias"]
    assert [one.verdict for one in reported] == ["tentative"]


def test_a_name_that_resembles_the_unknown_only_in_slow_flight_is_not_in_the_repair(monkeypatch):
    """A force against the velocity at up to 12 m/s of 15, and none beyond: as a drag, it would slow down a race."""
    monkeypatch.setattr(references, "REFERENCE_FLIGHTS", REFERENCE_FLIGHTS)
    table = flight(3)
    q, p, force = (table[name] for name in ("q_world_body", "p_world", "specific_force_body"))
    v_body = geometry.rotate_inverse(q.values, np.gradient(p.values, p.t, axis=0)) * [1.0, 1.0, 0.0]
    slow = np.linalg.norm(v_body, axis=1, keepdims=True) < 12.0
    changed = Samples(force.t, force.values - np.where(slow, 0.5 * v_body, 0.0))
    drag = {"rotor_drag": [6e-5]}
    chosen, _ = repair_of(FlightTable("slow", {**table.channels, "specific_force_body": changed}), drag, withdrawn=True)
    assert not chosen.names and [one.effect.id for one in chosen.left_out] == ["rotor_drag"]


def test_a_name_that_comes_back_to_the_file_beside_another_is_not_in_the_repair(monkeypatch):
    """The air pushes the vehicle on: the least drag is none, as in the file. The weight that was found stays."""
    monkeypatch.setattr(references, "REFERENCE_FLIGHTS", REFERENCE_FLIGHTS)
    table = flight(3, mass=[0.95])
    q, p, force = (table[name] for name in ("q_world_body", "p_world", "specific_force_body"))
    v_body = geometry.rotate_inverse(q.values, np.gradient(p.values, p.t, axis=0))
    pushed = Samples(force.t, force.values + 0.1 * v_body)
    changed = FlightTable("pushed", {**table.channels, "specific_force_body": pushed})
    chosen, reported = repair_of(changed, {"mass": [0.95], "linear_drag": [0.1, 0.1, 0.1]}, withdrawn=True)
    assert [one.effect.id for one in chosen.names] == ["mass"]
    assert [one.effect.id for one in chosen.left_out] == ["linear_drag"]
    assert [one.effect.id for one in reported] == ["mass"]
