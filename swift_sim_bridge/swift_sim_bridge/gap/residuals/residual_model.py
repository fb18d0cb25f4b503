"""Measured less replayed, layer by layer, each layer with measured inputs so that no fault leaks downstream.

What sensors are supposed to do wrong is taken out of the recording first (`correction`); then both sides of every
equation go through the same filter (`filters`), and nothing measured is compared with its own derivative.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import chain

import numpy as np

from swift_ros import geometry
from swift_ros.vehicle import GRAVITY, Vehicle
from swift_sim_bridge.effects import Effect
from swift_sim_bridge.gap.effects.injection import inject
from swift_sim_bridge.gap.recording import gate_observations
from swift_sim_bridge.gap.recording.recording import Recording
from swift_sim_bridge.gap.residuals import kinematics, odometry, physics_replay
from swift_sim_bridge.gap.residuals.channels import ELECTRICAL_POWER, VOLTAGE, Channel, residual_groups
from swift_sim_bridge.gap.residuals.filters import Filter, apply, averaged, derivative, lagged, over_batch
from swift_sim_bridge.gap.residuals.kinematics import Kinematics
from swift_sim_bridge.gap.residuals.sensor_correction import (
    OF_ACCELEROMETER,
    OF_GYRO,
    OF_VIO,
    accelerometer_errors,
    correct,
    differing,
    terms_of,
)
from swift_sim_bridge.physics import battery
from swift_sim_bridge.physics.state import parameters_from_vehicle
from swift_sim_bridge.sensors.clock import Moving
from swift_sim_bridge.sensors.terms import sensor_terms

RESTS_ON = {
    "vio": ("p_vio", "q_vio_body"),
    "motor": ("motor_command", "voltage"),
    VOLTAGE: ("voltage", "current"),
    ELECTRICAL_POWER: ("voltage", "current"),
}  # by quantity or layer of a channel: what may begin late or pause


@dataclass(frozen=True)
class Variants:
    """Vehicles with the same terms (see `patch.with_idle_terms`), and what each changes against the first: `motor`,
    `motion` (forces, moments, air), `imu` (any sensor but the camera, VIO too), `camera` (and the map) or `command`;
    sides: of each parameter that moves, which vehicle has it moved up and which down, the first where none has."""

    vehicles: tuple[Vehicle, ...]
    changes: tuple[str, ...]
    sides: tuple[tuple[int, int], ...] = ()

    @cached_property
    def _parameters(self) -> dict:
        sets = {name: [self.vehicles[i] for i in self.rows(name)] for name in ("motor", "motion")}
        return {
            name: physics_replay.stack_parameters(some)
            for name, some in (sets | {"centre": [self.vehicles[0]]}).items()
        }

    @cached_property
    def sensors(self) -> list[dict]:
        """The sensor terms of each vehicle."""
        return [sensor_terms(vehicle) for vehicle in self.vehicles]

    def parameters(self, name: str):
        """Return the stacked parameters of those that change this, the first before them; "centre": of the first."""
        return self._parameters[name]

    def rows(self, *names: str) -> list[int]:
        """Return which vehicles change one of these, the first before them."""
        return [0, *(i for i, change in enumerate(self.changes) if i and change in names)]


@dataclass(frozen=True)
class ResidualModel:
    """Residuals of one recording for variants of a vehicle. own: effects with their values, by which the vehicle was
    other in this recording than in others; without: groups of channels that are not compared."""

    recording: Recording
    own: tuple[tuple[Effect, np.ndarray], ...] = ()
    without: frozenset[str] = frozenset()

    @cached_property
    def filter(self) -> Filter:
        return Filter(len(self.recording.t), self.recording.dt)

    @cached_property
    def t(self) -> np.ndarray:
        """Times (m,) s of the residuals."""
        return self.recording.t[self.filter.rows]

    @cached_property
    def groups(self) -> dict[str, tuple[Channel, ...]]:
        return {name: group for name, group in residual_groups(self.recording).items() if name not in self.without}

    @cached_property
    def channels(self) -> tuple[Channel, ...]:
        return tuple(chain.from_iterable(self.groups.values()))

    @cached_property
    def columns(self) -> dict[str, slice]:
        """Where the channels of each group stand among all."""
        ends = np.cumsum([len(group) for group in self.groups.values()])
        return {name: slice(end - len(self.groups[name]), end) for name, end in zip(self.groups, ends, strict=True)}

    @cached_property
    def good(self) -> np.ndarray:
        """The residuals (m,) that rest on measurements alone, in flight: the same ones whatever vehicle is tried."""
        bad = ~(self.recording.good & self.recording.flown)
        return np.asarray(self.filter.whole @ bad.astype(float)).ravel() < 0.5

    def residuals(self, variants: Variants) -> np.ndarray:
        """Return the residuals (b, m, c) of each variant. What a variant does not touch is taken from the first."""
        if self.own:
            variants = replace(variants, vehicles=tuple(self._as_it_was(vehicle) for vehicle in variants.vehicles))
        told = [one for one in self._told(variants) if one[0] in self.groups]
        first = {group: values[0] for group, rows, values in told if rows[0] == 0}
        first = np.concatenate([first[group] for group in self.groups], axis=-1)
        found = np.repeat(first[None], len(variants.vehicles), axis=0)
        for group, rows, values in told:
            found[:, :, self.columns[group]][rows] = values
        for i, rows in self._unheard.items():
            found[:, rows, i] = 0.0
        return found

    def _told(self, variants: Variants) -> Iterator[tuple[str, list[int], np.ndarray]]:
        """Yield groups of channels with the vehicles that tell anything of their own in them, and what they tell, one
        for each or the same for all (1 or k, m, c): the first vehicle, for which all others stand that follow with
        nothing, comes first."""
        recording, vehicles = self.recording, variants.vehicles
        if recording.motor_record is not None:
            yield "rotors", variants.rows("motor"), self._motors(variants.parameters("motor"))
        if recording.has("voltage", "rotor_speed"):
            pack = [(vehicle.battery, vehicle.torque_coefficient) for vehicle in vehicles]
            rows = [i for i in variants.rows("motor", "motion") if not i or pack[i] != pack[0]]
            yield "pack", rows, self._pack([vehicles[i] for i in rows])
        if recording.has("p_world", "q_world_body", "gyro_body"):
            yield from self._moved(variants)
        if recording.command_link:
            rows = variants.rows("command")
            yield "command", rows, self._commands([vehicles[i].terms for i in rows])
        if recording.rate_loop:
            rows = variants.rows("command")
            yield "rate loop", rows, self._demands([vehicles[i] for i in rows])

    def _moved(self, variants: Variants) -> Iterator[tuple[str, list[int], np.ndarray]]:
        """Yield what `_told` does of all that is held against the pose. Of an instrument only that is worked out anew
        which it shows in."""
        recording, terms = self.recording, variants.sensors[0]
        seen = kinematics.of(recording, correct(recording, terms), self.filter)
        driven = self._driven(variants.parameters("motion"), seen)
        for group, values in self._motion(driven, seen, terms).items():
            yield group, variants.rows("motion"), values
        first = tuple(part[:1] for part in driven)
        for i in variants.rows("imu")[1:]:
            others = variants.sensors[i]
            odd = differing(terms, others)
            if len(terms_of(OF_VIO, odd)) == len(odd):
                groups = self._odometry(seen, others)
            elif len(terms_of(OF_ACCELEROMETER, odd)) == len(odd):
                groups = self._felt(first, seen, others)
            else:
                known = None if terms_of(OF_GYRO, odd) else seen
                corrected = correct(recording, others, known.gyro_body if known else None)
                own = kinematics.of(recording, corrected, self.filter, known)
                groups = self._motion(self._driven(variants.parameters("centre"), own), own, others)
            for group, values in groups.items():
                yield group, [i], values
        for i in variants.rows("camera")[1:]:
            for group, values in self._gates(seen.moving, variants.sensors[i]).items():
                yield group, [i], values

    def residual(self, vehicle: Vehicle) -> np.ndarray:
        """Return the residuals (m, c) of one vehicle."""
        return self.residuals(Variants((vehicle,), ("",)))[0]

    def _as_it_was(self, vehicle: Vehicle) -> Vehicle:
        for effect, values in self.own:
            vehicle = inject(vehicle, effect, values)
        return vehicle

    def _motors(self, parameters) -> np.ndarray:
        motor_record = self.recording.motor_record
        apart = motor_record.rotor_speed - physics_replay.rotor_speeds(parameters, motor_record)
        at_grid = np.stack([[np.interp(self.recording.t, motor_record.t, rotor) for rotor in one.T] for one in apart])
        return np.moveaxis(apply(self.filter.smooth, np.moveaxis(at_grid, -1, 0)), 0, 1)

    def _commands(self, terms: list[dict]) -> np.ndarray:
        """Return what the rate loop heard less what was sent (b, m, 4)."""
        line = self.recording.command_link
        return self._of_passes(line.passes, line.residuals(terms))

    def _demands(self, vehicles: list[Vehicle]) -> np.ndarray:
        """Return what the rate loop asked of the motors less what the file's loop would have (b, m, 3)."""
        log = self.recording.rate_loop
        return self._of_passes(log, log.residual(vehicles))

    def _of_passes(self, passes, apart) -> np.ndarray:
        """Return values (b, m, k) of passes of the rate loop (b, n, k), averaged over the steps of the grid first: they
        come in stairs. passes: has their times t (n,) s and step_s."""
        recording, flat = self.recording, np.moveaxis(apart, 1, 0).reshape(apart.shape[1], -1)
        total = np.concatenate([np.zeros((1, flat.shape[1])), np.cumsum(flat, axis=0)]) * passes.step_s
        stamps = np.append(passes.t, passes.t[-1] + passes.step_s)
        begin, end = recording.t - 0.5 * recording.dt, recording.t + 0.5 * recording.dt
        mean = (
            np.stack([np.interp(end, stamps, column) - np.interp(begin, stamps, column) for column in total.T], axis=-1)
            / recording.dt
        )
        return np.moveaxis(apply(self.filter.smooth, mean.reshape(len(mean), len(apart), -1)), 1, 0)

    def _pack(self, vehicles: list[Vehicle]) -> np.ndarray:
        """Return voltage about its mean, as how full the pack was at the start is not known, and, with a measured
        current, power (b, m, 1 or 2)."""
        recording, found = self.recording, []
        cubed = np.sum(recording.rotor_speed**3, axis=1)
        heard = ~recording.in_gap(*RESTS_ON[VOLTAGE])
        for vehicle in vehicles:
            pack = parameters_from_vehicle(vehicle, np.float64, np.asarray).battery
            power_w = vehicle.torque_coefficient * cubed / pack.efficiency + pack.avionics_w
            drawn = recording.current if recording.has("current") else power_w / recording.voltage
            charge = np.cumsum(drawn) * recording.dt
            behind = lagged(drawn, recording.dt, pack.rc_time) * pack.rc_resistance
            if pack.rc2_time:
                behind = behind + lagged(drawn, recording.dt, pack.rc2_time) * pack.rc2_resistance
            full = np.asarray(battery.open_circuit(charge, pack, None))
            voltage = recording.voltage - (full - battery.resistance(pack, None) * drawn - behind)
            columns = [voltage - voltage[heard].mean()]
            if recording.has("current"):
                columns.append(recording.voltage * recording.current - power_w)
            found.append(averaged(np.stack(columns, axis=-1), recording.dt)[self.filter.rows])
        return np.stack(found)

    def _driven(self, parameters, seen: Kinematics) -> tuple[np.ndarray, np.ndarray]:
        """Return specific force m/s^2 and angular acceleration rad/s^2 (b, n, 3) by the rotors' speeds; where these, or
        for the latter each one's, are not known, as measured."""
        recording, moving, gyro = self.recording, seen.moving, seen.gyro_body
        alike = np.ones((len(parameters.mass), 1, 1))
        measured_turn = alike * derivative(gyro, recording.dt)
        if not recording.has("rotor_speed"):
            force = recording.specific_force_body if recording.has("specific_force_body") else np.zeros_like(gyro)
            return alike * force, measured_turn
        slope = derivative(recording.rotor_speed, recording.dt)
        inputs = physics_replay.MeasuredMotion(
            moving.p_world, moving.q_world_body, moving.v_world, gyro, recording.rotor_speed, slope
        )
        force, turn = physics_replay.forces(parameters, inputs)
        return force, turn if recording.has("single_rotor_speeds") else measured_turn

    def _motion(self, driven, seen: Kinematics, terms: dict) -> dict[str, np.ndarray]:
        """Return the residuals (1 or b, m, k) of force, moment and of the instruments among themselves, by group;
        driven: see `_driven`."""
        found = self._felt(driven, seen, terms)
        if self.recording.has("single_rotor_speeds"):
            found["moment"] = seen.turn_acceleration - over_batch(self.filter.smooth, driven[1])
        found["gyro"] = seen.turning[None]
        return found | self._gates(seen.moving, terms) | self._odometry(seen, terms)

    def _felt(self, driven, seen: Kinematics, terms: dict) -> dict[str, np.ndarray]:
        """Return those of the accelerometer: against the force by the rotors' speeds, and the pose's against it."""
        recording, low, found = self.recording, self.filter, {}
        if not recording.has("specific_force_body"):
            return found
        force, turn = driven if recording.has("rotor_speed") else (part[:1] for part in driven)
        true = recording.specific_force_body - accelerometer_errors(terms, seen.gyro_body, force, turn)
        if recording.has("rotor_speed"):
            found["force"] = over_batch(low.smooth, true - force)
        world = geometry.rotate(np.broadcast_to(seen.moving.q_world_body, (*true.shape[:-1], 4)), true)
        between = seen.acceleration + [0.0, 0.0, GRAVITY] - over_batch(low.twice, world)
        middle = np.broadcast_to(seen.q_world_body, (*between.shape[:-1], 4))
        return found | {"accelerometer": geometry.rotate_inverse(middle, between)}

    @cached_property
    def _unheard(self) -> dict[int, np.ndarray]:
        """When (m,) there was no measurement to compare, by channel of those that have such times."""
        recording, found = self.recording, {}
        for i, channel in enumerate(self.channels):
            in_gap = recording.in_gap(*RESTS_ON.get(channel.quantity, RESTS_ON.get(channel.layer, ())))
            if channel.layer == "motor":  # averaged over a second, or driven by what was before
                in_gap = averaged(in_gap[:, None].astype(float), recording.dt)[:, 0] > 1e-9
            if in_gap.any():
                found[i] = np.asarray(self.filter.whole @ in_gap.astype(float)).ravel() > 0.5
        return found

    @cached_property
    def seen_at(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Which sightings (k,) are compared, and the row (k,) and slot (k,) of the residuals where each stands."""
        row, rank = self.recording.gate_observations.places(self.t)
        kept = np.flatnonzero(rank < gate_observations.GATES_PER_IMAGE)
        return kept, row[kept], rank[kept]

    @cached_property
    def measured(self) -> np.ndarray:
        """Where (m, c) there is anything to compare: gates are in few images, VIO, motor commands and the pack's meters
        may begin late or pause, all else is always there."""
        there = np.ones((len(self.t), len(self.channels)), bool)
        if columns := self.columns.get("camera"):
            _, row, slot = self.seen_at
            seen = np.zeros((len(self.t), gate_observations.GATES_PER_IMAGE), bool)
            seen[row, slot] = True
            there[:, columns] = np.repeat(seen, 8, axis=1)
        for i, rows in self._unheard.items():
            there[rows, i] = False
        return there

    def _gates(self, moving: Moving, terms: dict) -> dict[str, np.ndarray]:
        """Return detected less projected corners (1, m, 8 a slot) px at the row nearest to each image, zero elsewhere;
        nothing without a camera."""
        if not self.recording.has("gate_observations"):
            return {}
        kept, row, slot = self.seen_at
        apart = self.recording.gate_observations.residual(self.recording.t, moving, terms)[kept]
        found = np.zeros((1, len(self.t), gate_observations.GATES_PER_IMAGE, 8))
        found[0, row, slot] = apart.reshape(len(kept), 8)
        return {"camera": found.reshape(1, len(self.t), -1)}

    @cached_property
    def _v_vio(self) -> np.ndarray:
        """VIO's velocity (m, 3) m/s in the body as it sees it."""
        told = apply(self.filter.slope, self.recording.p_vio)
        return geometry.rotate_inverse(self.recording.q_vio_body[self.filter.rows], told)

    def _odometry(self, seen: Kinematics, terms: dict) -> dict[str, np.ndarray]:
        """Return VIO's less the pose's velocity (1, m, 3) m/s, each in the body as it sees it: so no common frame is
        needed; nothing without VIO."""
        if not self.recording.has("p_vio", "q_vio_body"):
            return {}
        q = seen.q_world_body
        return {"vio": (self._v_vio - geometry.rotate_inverse(q, odometry.velocity(q, seen.v_world, terms)))[None]}
