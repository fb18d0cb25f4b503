"""Physics by an author who had not read the tool: each law agrees with an independent formula and acts as its story."""

from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from referee_story import answer, equation, finding, report
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from swift_sim_bridge.referee import cases, scoring, summary
from swift_sim_bridge.referee.effects.laws import BLIND
from swift_sim_bridge.referee.effects.planting import conceal
from swift_sim_bridge.referee.simulator import blind, flight, plant, polynomial, vehicles

SPIN = np.array([1100.0, 1300.0, 1250.0, 900.0])
NOTHING = (0.0, 0.0, 0.0)


@pytest.fixture(autouse=True)
def double_precision():
    with jax.enable_x64(True):
        yield


def vehicle() -> dict:
    return vehicles.draw_vehicle(np.random.default_rng(3), "test") | {"terms": {}}


def planted(law: str, seed: int = 2) -> dict:
    """Return a vehicle with a law in the size of its author."""
    return conceal(vehicle(), BLIND[law].plant(vehicle(), 1.0, np.random.default_rng(seed)))


def numbers_of(law: str) -> SimpleNamespace:
    return SimpleNamespace(**{name: np.array(value) for name, value in planted(law)["blind"][law].items()})


def slopes(content: dict, v=NOTHING, w=NOTHING, spin=SPIN, memory=blind.REST, among=()):
    """Return the state's rate and the outputs of a level vehicle at a command of 0.3."""
    rows = [tuple(jnp.asarray(float(x)) for x in row) for row in ((0.0, 0.0, 5.0), (0.0, 0.0, 0.0, 1.0), v, w, spin)]
    numbers = plant.plant_of(content, among=among)
    state = plant.State(*rows, jnp.asarray(300.0), jnp.asarray(0.1), memory if numbers["blind"] else ())
    inputs = plant.Inputs((0.3,) * 4, NOTHING, NOTHING, NOTHING, (0.0,) * 4)
    return plant.derivative(state, inputs, numbers)


def more_wrench(law: str, **at) -> tuple[np.ndarray, np.ndarray]:
    """Return the force (N) and the moment (N m) in the body that a law adds."""
    content = planted(law)
    (_, after), (_, before) = slopes(content, **at), slopes(vehicle(), **(at | {"memory": ()}))
    force = content["mass"] * np.subtract(after.specific_force, before.specific_force)
    turning = np.subtract(after.angular_acceleration, before.angular_acceleration)
    return force, np.array(content["inertia"]) * turning


def forward(law: str, memory_at: int, seconds: float, v=NOTHING, w=NOTHING, force=(0.0, 0.0, 9.8), start=blind.REST):
    """Return one number of the memory (n,) after a time of constant motion, at n times."""
    numbers = {"blind": blind.parameters_of(planted(law))}
    outputs = SimpleNamespace(specific_force=force, angular_acceleration=NOTHING)
    rate = jax.jit(lambda memory: blind.memory_rate(tuple(memory), v, w, outputs, numbers))
    moved = solve_ivp(lambda _, memory: rate(memory), (0.0, seconds), start, max_step=0.02, rtol=1e-8, atol=1e-10)
    return moved.y[memory_at]


def test_a_wake_locks_to_one_side_and_stays_there_after_the_sideslip_that_flipped_it():
    law = numbers_of("bistable_wake")
    straight, speed = (15.0, 0.0, -8.0), 17.0
    growth = (speed**2 - law.critical_speed**2) / (speed**2 + law.critical_speed**2)
    push = np.tanh(speed / law.critical_speed) * law.bias
    settled = np.sort(np.roots([-1.0, 0.0, growth, push]).real)
    first = forward("bistable_wake", 0, 3.0, straight)[-1]
    assert first == pytest.approx(settled[2] if law.bias > 0 else settled[0], abs=1e-5)
    slipping = (15.0, -np.sign(law.bias) * 12.0, -8.0)
    flipped = forward("bistable_wake", 0, 2.0, slipping, start=(first, 0.0, 0.0))[-1]
    after = forward("bistable_wake", 0, 3.0, straight, start=(flipped, 0.0, 0.0))[-1]
    assert after == pytest.approx(settled[0] if law.bias > 0 else settled[2], abs=1e-5)
    force, moment = more_wrench("bistable_wake", v=straight, memory=(after, 0.0, 0.0))
    assert force == pytest.approx([0.0, -0.5 * 1.2 * speed**2 * law.lift_area * after, 0.0], abs=1e-9)
    assert moment == pytest.approx(np.zeros(3), abs=1e-9) and 0.5 < abs(force[1]) < 2.5


def test_a_twisting_arm_turns_the_thrust_of_its_rotor_about_itself():
    law, content, w = numbers_of("twisting_arm"), vehicle(), np.array([4.0, -6.0, 1.0])
    i = int(np.flatnonzero(law.softness)[0])
    place = np.array(content["rotors"][i]["position"])
    along = place / np.linalg.norm(place)
    thrust = content["thrust_coefficient"] * SPIN[i] ** 2
    momentum = law.rotor_inertia * content["rotors"][i]["spin"] * SPIN[i] * np.array([0.0, 0.0, 1.0])
    torsion = -np.cross(w, momentum) @ along + law.shear_offset * thrust
    twist = 0.12 * np.tanh(torsion * law.softness[i] / 0.12)
    upright = np.array([0.0, 0.0, thrust])
    expected = Rotation.from_rotvec(twist * along).apply(upright) - upright
    force, moment = more_wrench("twisting_arm", w=tuple(w))
    assert force == pytest.approx(expected, abs=1e-9) and abs(twist) > 1e-3
    assert moment == pytest.approx(np.cross(place, expected), abs=1e-9)


def test_a_loose_pack_stays_within_its_friction_and_creeps_to_the_end_of_its_slack_beyond_it():
    law = numbers_of("sliding_battery")
    hold = law.preload + law.friction * 9.8
    assert np.all(forward("sliding_battery", 1, 1.0, force=(0.99 * hold, 0.0, 9.8)) == 0.0)
    creeping = forward("sliding_battery", 1, 0.1, force=(-hold - 0.5, 0.0, 9.8))[-1]
    assert creeping == pytest.approx(0.1 * 0.5 * law.mobility, rel=1e-6)
    end = forward("sliding_battery", 1, 3.0, force=(-hold - 5.0, 0.0, 9.8))[-1]
    end = float(blind.limited((0.0, end, 0.0), {"blind": blind.parameters_of(planted("sliding_battery"))})[1])
    assert end == pytest.approx(law.slack)
    thrust = vehicle()["thrust_coefficient"] * np.sum(SPIN**2)
    force, moment = more_wrench("sliding_battery", memory=(0.0, end, 0.0))
    assert moment == pytest.approx([0.0, law.battery * end / vehicle()["mass"] * thrust, 0.0], abs=1e-9)
    assert force == pytest.approx(np.zeros(3), abs=1e-9)


def test_a_spinning_vehicle_throws_its_loose_pack_outwards():
    law, w = numbers_of("sliding_battery"), (0.0, 0.0, 40.0)
    place = 0.8 * float(law.slack)
    excess = place * 40.0**2 - law.preload - law.friction * 9.8
    rate = forward("sliding_battery", 1, 1e-4, w=w, start=(0.0, place, 0.0))[-1] - place
    assert rate == pytest.approx(1e-4 * law.mobility * excess, rel=1e-2)


def test_a_resonant_arm_takes_the_power_of_an_oscillator_that_an_unbalance_shakes():
    law = numbers_of("arm_resonance")
    after, before = (slopes(content)[0].rotor_speed for content in (planted("arm_resonance"), vehicle()))
    r = SPIN / law.mode
    amplitude = r**2 / np.abs(1.0 - r**2 + 2j * law.damping * r)  # in multiples of the unbalance's eccentricity
    at_resonance = 1.0 / (2.0 * law.damping)
    assert np.subtract(before, after) == pytest.approx(law.peak * r * (amplitude / at_resonance) ** 2, rel=1e-9)
    at_mode, free = (slopes(content, spin=law.mode)[0].rotor_speed for content in (planted("arm_resonance"), vehicle()))
    assert np.subtract(free, at_mode) == pytest.approx(law.peak, rel=1e-9)


def test_a_worn_connector_opens_under_load_heals_and_drops_the_voltage_of_a_high_current():
    law = numbers_of("fretting_connector")
    opening_rate = law.opening_rate * (30.0 - law.threshold)
    total = opening_rate + 1.0 / law.healing_time
    opened = forward("fretting_connector", 2, 0.2, force=(0.0, 0.0, 30.0))[-1]
    assert opened == pytest.approx(opening_rate / total * (1.0 - np.exp(-0.2 * total)), rel=1e-5)
    healed = forward("fretting_connector", 2, 0.5, start=(0.0, 0.0, opened))[-1]
    assert healed == pytest.approx(opened * np.exp(-0.5 / law.healing_time), rel=1e-5)
    (_, before), (slope, after) = slopes(vehicle()), slopes(planted("fretting_connector"), memory=(0.0, 0.0, opened))
    most = 0.15 * before.voltage
    lost = most * np.tanh(law.resistance * opened * before.current / most)
    assert float(before.voltage - after.voltage) == pytest.approx(float(lost), rel=1e-9) and lost > 0.1
    assert float(after.voltage * after.current) == pytest.approx(float(before.voltage * before.current))
    assert float(slope.charge) == float(after.current)


def test_a_vehicle_without_the_laws_flies_the_same_beside_one_that_has_them_and_alone_has_no_memory():
    alone, beside = (
        slopes(vehicle(), (9.0, 3.0, -2.0)),
        slopes(vehicle(), (9.0, 3.0, -2.0), among=[planted("bistable_wake")]),
    )
    assert jax.tree.leaves(alone) == jax.tree.leaves(beside[0]._replace(memory=())) + list(jax.tree.leaves(beside[1]))
    assert beside[0].memory == blind.REST and alone[0].memory == ()
    assert plant.plant_of(vehicle())["blind"] == {}
    assert set(blind.IDLE) == set(BLIND)


@pytest.mark.parametrize("law", BLIND)
def test_each_law_plants_all_its_numbers_in_the_size_of_its_author(law):
    drawn = [cases.draw_case("strange_blind", seed) for seed in range(2 * len(BLIND))]
    mine = [case for case in drawn if case.hidden[0].effect == law]
    assert len(mine) == 2
    for case in mine:
        assert set(case.order.content["blind"][law]) == set(blind.IDLE[law])
        assert (case.hidden[0].size, case.hidden[0].multiple, case.removed) == (1.0, 3.0, ())
        assert "blind" not in case.vehicle and case.held_out.content == case.order.content


def test_the_laws_are_flown_in_races_as_fast_as_their_author_had_in_mind_with_the_nose_ahead():
    for seed in range(6):
        case = cases.draw_case("strange_blind", seed)
        assert case.notes["path"] == "race"
        for path in (case.order.path, case.held_out.path):
            speed = np.linalg.norm(path.v, axis=1)
            assert 14.0 < speed.max() <= 21.0
            flown = speed > 1.0
            across = path.v[:, 1] * np.cos(path.yaw) - path.v[:, 0] * np.sin(path.yaw)
            assert np.abs(across[flown]).max() < 1e-6
            assert np.ptp(np.sign(path.yaw_rate[flown])) == 2.0  # turns to both sides


def test_memory_is_integrated_with_the_flight_and_stays_within_its_limits():
    content = planted("sliding_battery")
    numbers = jax.tree.map(lambda leaf: jnp.asarray(leaf, float), plant.plant_of(content))
    rows = [tuple(jnp.asarray(float(x)) for x in row) for row in (NOTHING, (0.0, 0.0, 0.0, 1.0), NOTHING, NOTHING)]
    start = plant.State(*rows, (jnp.asarray(1200.0),) * 4, jnp.asarray(0.0), jnp.asarray(0.0), (jnp.asarray(0.0),) * 3)
    pushed = plant.Inputs((0.3,) * 4, NOTHING, (-8.0, 0.0, 0.0), NOTHING, (0.0,) * 4)
    step = jax.jit(lambda at: flight.rk4(at, pushed, numbers, 0.001))
    places = []
    for _ in range(400):
        start = step(start)
        places.append(float(start.memory[1]))
    slack = content["blind"]["sliding_battery"]["slack"]
    assert places[-1] == slack and max(places) == slack and places == sorted(places)


RIGHT = {
    "bistable_wake": ("force", "specific_force_y: |v| v_y", "specific_force_y: omega_x"),
    "twisting_arm": ("moment", "angular_acceleration_z: sum of spin Omega omega_y", "angular_acceleration_z: v_x"),
    "sliding_battery": ("moment", "angular_acceleration_y: thrust", "angular_acceleration_y: omega_z"),
    "arm_resonance": ("motor", "rotor_speed_2: Omega", "rotor_speed_2: t"),
    "fretting_connector": ("motor", "voltage: current", "voltage: charge"),
}


@pytest.mark.parametrize("law", BLIND)
def test_the_right_answer_is_unknown_in_the_law_s_layer_and_on_its_axis_and_its_quantity_counts_apart(law):
    layer, right, other_quantity = RIGHT[law]

    def scored(*findings):
        record = scoring.score(answer(law, family="strange_blind", multiple=3.0), report(*findings))
        return tuple(record[f"{part}_on_knockout"] for part in ("unknown", "axis", "quantity"))

    assert scored(equation(right, layer=layer)) == (True, True, True)
    assert scored(equation(other_quantity, layer=layer)) == (True, True, False)
    assert scored(equation("vio_velocity_x: t", layer=layer)) == (True, False, False)
    assert scored(equation(right, layer="imu")) == (False, False, False)
    assert scored(equation(right, layer=layer), finding("mass")) == (False, False, False)
    assert scored() == (False, False, False)


def test_what_a_repair_removes_counts_apart_from_exact_names_and_only_where_the_law_acts():
    good, bad = (
        scoring.score(
            answer("arm_resonance", family="strange_blind"), report(equation(RIGHT["arm_resonance"][1], layer="motor"))
        )
        | {"removed": share, "acts_sigma": acts}
        for share, acts in ((0.9, 60.0), (0.4, 11.0))
    )
    idle = bad | {"axis_on_knockout": False, "acts_sigma": 0.0}  # nothing of it is in the recording
    result = summary.summarise([good, bad, idle], "own")
    rates = {rate["name"]: (rate["hits"], rate["count"]) for rate in result["rates"]}
    (name,) = (name for name in rates if name.startswith("physics without a name: 80 %"))
    assert rates[name] == (1, 2) and rates["physics without a name: unknown, correct layer and axis"] == (2, 2)
    assert result["numbers"]["held_out_count"] == 0


def test_an_equation_of_motors_and_pack_is_flown_as_the_vehicle_file_says():
    row = {"coefficient": 0.5, "range": [-1e4, 1e4]}
    alone = row | {"coefficient": -40.0}
    sides = {
        "rotor_speed": {"U sqrt(u)": row, "1": row, "rotor_3 u": alone},
        "voltage": {"current": row | {"coefficient": -0.002}},
    }
    repaired = vehicle() | {
        "terms": {"equation": sides | {"voltage": sides["voltage"] | {"Omega^3": row | {"range": [0, 2]}}}}
    }
    numbers = plant.plant_of(repaired, polynomial.summands_of([repaired]))
    rows = [
        tuple(jnp.asarray(float(x)) for x in row) for row in (NOTHING, (0.0, 0.0, 0.0, 1.0), NOTHING, NOTHING, SPIN)
    ]
    state = plant.State(*rows, jnp.asarray(300.0), jnp.asarray(0.1))
    slope, outputs = plant.derivative(state, plant.Inputs((0.3,) * 4, NOTHING, NOTHING, NOTHING, (0.0,) * 4), numbers)
    _, before = slopes(vehicle())
    volts = float(before.voltage - 0.002 * before.current + 0.5 * 2)
    assert float(outputs.voltage) == pytest.approx(volts)
    steady = plant.steady_speed(0.3, volts, numbers) + 0.5 * volts * np.sqrt(0.3) + 0.5
    steady = steady - np.array([0.0, 0.0, 40.0 * 0.3, 0.0])
    assert slope.rotor_speed == pytest.approx((steady - SPIN) / vehicle()["motor"]["time_constant_up"])
