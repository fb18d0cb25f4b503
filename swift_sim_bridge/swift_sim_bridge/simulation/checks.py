"""What is impossible about a vehicle for its simulator: terms, flight controller, and the link between both."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from swift_ros.betaflight import msp, read_back, sticks
from swift_ros.betaflight.link_settings import LinkSettings
from swift_ros.errors import UsageError
from swift_ros.plausibility.finding import IMPOSSIBLE, ODD, Finding
from swift_ros.vehicle import Vehicle
from swift_sim_bridge.effects import known_terms
from swift_sim_bridge.flight_controller.configuration.controller_section import (
    ControllerKeys,
    check_firmware_ranges,
    controller_from_vehicle,
)
from swift_sim_bridge.flight_controller.configuration.rates import RATES_TYPES, rate_profile
from swift_sim_bridge.flight_controller.firmware import FlightController, Readings
from swift_sim_bridge.flight_controller.firmware_settings import FirmwareSettings
from swift_sim_bridge.physics.terms.registry import coefficients_from_vehicle
from swift_sim_bridge.sensors.terms import sensor_terms

# Times the bound of an effect's parameter: no vehicle, but another unit. Those of instruments are of bad ones already.
FAR_BEYOND, FAR_BEYOND_OF_INSTRUMENTS = 10.0, 3.0
INSTRUMENTS = ("imu", "vio", "camera")  # layers of effects


def findings(records: dict, folder: Path | None) -> Iterator[tuple[str, Finding]]:
    """Yield (file name, finding), see `swift_ros.commands.joint_checks`."""
    vehicle, firmware = records.get("drone.yaml"), records.get(("simulation.yaml", "flight_controller"))
    link = records.get(("nodes.yaml", "betaflight"))
    found = vehicle_findings(vehicle) if vehicle is not None else []
    yield from (("drone.yaml", finding) for finding in found)
    if vehicle and firmware and link and not found:
        yield from (("simulation.yaml", finding) for finding in link_findings(vehicle, firmware, link))


def vehicle_findings(vehicle: Vehicle) -> list[Finding]:
    """Return what is impossible or odd about the terms and the flight controller of a vehicle file."""
    found = []
    for check in (coefficients_from_vehicle, sensor_terms, _check_controller):
        try:
            check(vehicle)
        except UsageError as error:
            sentence = str(error).removeprefix(f"the vehicle '{vehicle.name}'").lstrip(", ")
            found.append(Finding(IMPOSSIBLE, sentence))
    return found or list(dict.fromkeys(_coefficients(vehicle)))  # the variants of an effect share their parameters


def refuse_impossible(vehicle: Vehicle) -> None:
    """Raise UsageError when a term or the flight controller of a vehicle is impossible."""
    for finding in vehicle_findings(vehicle):
        if finding.level == IMPOSSIBLE:
            raise UsageError(f"the vehicle '{vehicle.name}', {finding.sentence}")


def link_findings(vehicle: Vehicle, firmware: FirmwareSettings, link: LinkSettings) -> list[Finding]:
    """Return why the node betaflight would not fly the simulated flight controller, as it finds out at its start."""
    if link.receiver != firmware.receiver:
        return [
            Finding(
                ODD,
                f"section 'flight_controller', 'receiver' is {firmware.receiver}, and nodes.yaml has {link.receiver}: "
                "simulated races are flown with the same in both",
            )
        ]
    rotors = np.zeros(len(vehicle.rotors))
    upright = np.array([0.0, 0.0, 0.0, 1.0])
    voltage = vehicle.battery.open_circuit_full
    try:
        controller = FlightController(
            firmware, vehicle, Readings(upright, np.zeros(3), voltage, 0.0, 0.0, rotors, rotors)
        )
        found = read_back.read_back(lambda code, payload=b"": _ask(controller, code, payload))
        blocks = read_back.check(found, vehicle, link.receiver, link.firmware_failsafe_s)
    except UsageError as error:
        return [Finding(IMPOSSIBLE, f"section 'flight_controller': {error}")]
    if sentence := _late_failsafe(firmware, read_back.failsafe_end_s(found.failsafe), link.firmware_failsafe_s):
        return [Finding(IMPOSSIBLE, sentence)]
    return [Finding(ODD, f"section 'flight_controller': no race is armed: {block}") for block in blocks]


def _late_failsafe(firmware: FirmwareSettings, end_s: float | None, longest_s: float) -> str | None:
    """Return what is wrong when the firmware's failsafe stops the motors too late, `end_s` or never; else None."""
    if end_s is not None and end_s <= longest_s:
        return None
    failsafe, never = firmware.failsafe, end_s is None
    landing = f" and 'failsafe.landing_s' {failsafe.landing_s:g} s" if failsafe.procedure == "land" else ""
    return (
        f"section 'flight_controller': no race is armed: by 'failsafe.delay_s' {failsafe.delay_s:g} s{landing} the "
        f"motors {'never stop' if never else f'stop {end_s:g} s'} after the last command, and 'firmware_failsafe_s' of "
        f"nodes.yaml allows {longest_s:g} s; give a smaller 'failsafe.delay_s', in s"
        + (", or the 'failsafe.procedure' drop" if landing else "")
    )


def _ask(controller: FlightController, code: int, payload: bytes) -> bytes | None:
    """Return the payload of an answer of the simulated flight controller, None for a refusal."""
    answer = next(iter(msp.Parser().feed(controller.feed(msp.encode(msp.Message(code, payload, msp.REQUEST))))))
    return answer.payload if answer.kind == msp.REPLY else None


def _check_controller(vehicle: Vehicle) -> None:
    """Raise UsageError unless a flight controller of Betaflight is configured as the firmware takes it."""
    if vehicle.controller.get("type") != "betaflight":
        return
    controller = controller_from_vehicle(vehicle)
    if isinstance(controller, ControllerKeys):
        check_firmware_ranges(controller)
    profile = rate_profile(controller)
    family = RATES_TYPES[profile.type]
    curves = sticks.RateCurves(family, profile.rc_rate, profile.super_rate, profile.expo, limit_deg_s=profile.limit)
    try:
        sticks.check_coverage(curves, vehicle.rates.max)
    except UsageError as error:
        raise UsageError(f"{error} under 'controller', or lower 'rates.max'") from error


def _coefficients(vehicle: Vehicle) -> Iterator[Finding]:
    """Yield the coefficients of terms beyond the bounds of the effects' parameters."""
    for name, entry in vehicle.terms.items():
        for effect in known_terms()[name].effects_of(name, vehicle, gates=1):
            for one in effect.parameters:
                value = _value(entry, one.path[2:]) if one.path[:2] == ("terms", name) else None
                low, high = one.bounds(vehicle)
                if value is None or low <= value <= high:
                    continue
                beyond = FAR_BEYOND_OF_INSTRUMENTS if effect.layer in INSTRUMENTS else FAR_BEYOND
                far = low == 0.0 > value or abs(value) > beyond * max(abs(low), abs(high))
                share = not one.unit and high < 1.0 < value
                unit = f" {one.unit}" if one.unit else ""
                sentence = (
                    f"'terms.{name}.{one.name}' is {value:g}{unit}, and vehicles of this size have {low:.3g} to "
                    f"{high:.3g}; correct it (`swiftros gap --explain {name}`)"
                )
                yield Finding(IMPOSSIBLE if far or share else ODD, sentence)


def _value(entry, path: tuple) -> float | None:
    """Return the number at a path of keys and indices; None where there is none."""
    for key in path:
        try:
            entry = entry[key]
        except (KeyError, IndexError, TypeError):
            return None
    return float(entry) if isinstance(entry, int | float | np.floating) and not isinstance(entry, bool) else None
