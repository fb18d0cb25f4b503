"""Whether the battery of a vehicle file can feed it. No ROS."""

from collections.abc import Iterator

from swift_ros.plausibility.finding import Check

# V of a cell: full 3.3 (lithium iron phosphate) to 4.45 (high voltage); none is discharged below 2.
FULL_CELL_V, COMMON_FULL_V, EMPTY_CELL_V = (3.2, 4.45), 3.9, 2.0
MAX_ABOVE_FULL = 1.05  # of the reference voltage over that of the full pack
MIN_HOVER_S, SHORT_HOVER_S, MAX_HOVER_S = 15.0, 120.0, 36_000.0  # on one charge
LARGE_SAG = 0.2  # share of its voltage that a pack loses by its resistances in hover; it has no power beyond 0.5
REFERENCE_CELSIUS = 25.0  # deg C at which the file gives the resistance
ENERGY_RATIO = (0.3, 3.0)  # of 'energy' over capacity times voltage
TEMPERATURES_C = (-60.0, 100.0)
MAX_SLOPE_PER_K = 0.2  # relative change of the resistance


def signs(vehicle) -> Iterator[str]:
    """Yield the quantities that must be positive, or not negative, and are."""
    battery = vehicle.battery
    for name in ("reference_voltage", "open_circuit_full", "capacity"):
        if not getattr(battery, name) > 0:
            yield f"'battery.{name}' must be positive"
    for name in (
        "resistance",
        "rc_resistance",
        "open_circuit_slope",
        "avionics_w",
        "rc2_resistance",
        "heat_capacity",
        "energy",
        "cells",
    ):
        if getattr(battery, name) < 0:
            yield f"'battery.{name}' must be 0 or more"
    if battery.rc_resistance > 0 and not battery.rc_time > 0:
        yield "'battery.rc_time' must be positive, in s"
    if not 0 < battery.efficiency <= 1:
        yield f"'battery.efficiency' is {battery.efficiency:g}; a motor gives a share of 0 to 1 of its power"


def _voltages(vehicle) -> Iterator[str]:
    battery, cells = vehicle.battery, vehicle.battery.cells
    full, empty = battery.open_circuit_full, battery.open_circuit_full - battery.open_circuit_slope
    if cells and not FULL_CELL_V[0] <= full / cells <= FULL_CELL_V[1]:
        yield (
            f"'battery.open_circuit_full' {full:g} V is {full / cells:.2f} V for each of {cells} 'cells'; full lithium "
            "cells have 3.3 to 4.45 V"
        )
        return
    if empty <= EMPTY_CELL_V * cells:
        yield (
            f"'battery.open_circuit_slope' {battery.open_circuit_slope:g} V leaves an empty pack no voltage that a "
            f"cell survives, {empty:.3g} V; give the drop in V over a whole discharge"
        )
    if battery.reference_voltage > MAX_ABOVE_FULL * full:
        yield (
            f"'battery.reference_voltage' {battery.reference_voltage:g} V exceeds the full pack's 'open_circuit_full' "
            f"{full:g} V; give the voltage of the full pack under load"
        )
    if battery.reference_voltage < 0.5 * full:
        yield (
            f"'battery.reference_voltage' {battery.reference_voltage:g} V is less than half of the full pack's "
            f"'open_circuit_full' {full:g} V; give the voltage of the pack, not of a cell"
        )
    curve = battery.open_circuit_curve
    if curve and not (min(curve) > EMPTY_CELL_V * cells and curve[0] >= curve[-1] and max(curve) <= 1.1 * full):
        yield "'battery.open_circuit_curve' must fall from the voltage of the full pack to that of the empty one, in V"


def _hover_s(vehicle) -> tuple[float, float]:
    """Return the power in hover, W, and the time for which one charge feeds it, s."""
    battery = vehicle.battery
    rotors_w = len(vehicle.rotors) * vehicle.torque_coefficient * vehicle.hover_speed**3
    power_w = rotors_w / battery.efficiency + battery.avionics_w
    return power_w, battery.capacity * battery.open_circuit_full / max(power_w, 1e-9)


def _highest_power_w(vehicle) -> float:
    """Return the largest power that the full pack gives for long, U^2 / 4R: then half of its voltage is lost."""
    battery = vehicle.battery
    warmed = 1.0 + battery.temperature_slope * (battery.temperature - REFERENCE_CELSIUS)
    resistance = battery.resistance * max(warmed, 0.0) + battery.rc_resistance + battery.rc2_resistance
    full = battery.open_circuit_curve[0] if battery.open_circuit_curve else battery.open_circuit_full
    return full**2 / max(4.0 * resistance, 1e-12)


def _sag(vehicle) -> float:
    """Return the share of the voltage that the pack loses by its resistances in hover, 0 to 0.5.

    The current I = P/U falls with the terminal voltage U = E - R I, the larger root of U^2 - E U + R P = 0.
    """
    share = _hover_s(vehicle)[0] / _highest_power_w(vehicle)
    return 0.5 - 0.5 * max(1.0 - share, 0.0) ** 0.5


def charge(vehicle) -> Iterator[str]:
    """Yield what contradicts the power of hover, which follows from masses, rotors and torques."""
    battery, (power_w, hover_s) = vehicle.battery, _hover_s(vehicle)
    if not MIN_HOVER_S <= hover_s <= MAX_HOVER_S:
        yield (
            f"'battery.capacity' {battery.capacity:g} A s feeds the {power_w:.3g} W of hover for {hover_s:.2g} s; 1 Ah "
            "is 3,600 A s; check 'torque_coefficient' and 'battery.avionics_w' too"
        )
    elif power_w > _highest_power_w(vehicle):
        yield (
            f"hover needs {power_w:.3g} W, and through its resistances the battery gives "
            f"{_highest_power_w(vehicle):.3g} W at most; give 'battery.resistance', 'rc_resistance' and "
            "'rc2_resistance' in ohm, not milliohm"
        )
    charge_j = battery.capacity * battery.open_circuit_full
    if battery.energy and not ENERGY_RATIO[0] <= battery.energy / charge_j <= ENERGY_RATIO[1]:
        yield (
            f"'battery.energy' {battery.energy:g} J contradicts 'capacity' times 'open_circuit_full', "
            f"{charge_j:.3g} J; 1 Wh is 3,600 J"
        )


def _warmth(vehicle) -> Iterator[str]:
    battery = vehicle.battery
    if not TEMPERATURES_C[0] <= battery.temperature <= TEMPERATURES_C[1]:
        yield f"'battery.temperature' is {battery.temperature:g}; give degrees Celsius, from -60 to 100"
    if abs(battery.temperature_slope) > MAX_SLOPE_PER_K:
        yield f"'battery.temperature_slope' is {battery.temperature_slope:g}; give the relative change for 1 K"


def _odd(vehicle) -> Iterator[str]:
    battery, cells = vehicle.battery, vehicle.battery.cells
    if cells and battery.open_circuit_full / cells < COMMON_FULL_V:
        each = battery.open_circuit_full / cells
        yield f"a full cell has {each:.2f} V; those of lithium polymer have 4.2 V; check 'battery.cells'"
    if _hover_s(vehicle)[1] < SHORT_HOVER_S:
        yield f"the battery feeds {_hover_s(vehicle)[1]:.0f} s of hover; 1 Ah of 'battery.capacity' is 3,600 A s"
    if _sag(vehicle) > LARGE_SAG:
        yield f"in hover the resistances of the battery take {100 * _sag(vehicle):.0f} % of its voltage"


IMPOSSIBLE: tuple[Check, ...] = (_voltages, _warmth)
ODD: tuple[Check, ...] = (_odd,)
