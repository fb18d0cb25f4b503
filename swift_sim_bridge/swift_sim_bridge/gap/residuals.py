"""Measured less replayed, layer by layer, each layer with measured inputs so that no fault leaks downstream.

What sensors are supposed to do wrong is taken out of the recording first (`correction`); then both sides of every
equation go through the same filter (`filters`), and nothing measured is compared with its own derivative.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from swift_ros import geometry
from swift_ros.vehicle import GRAVITY, Vehicle
from swift_sim_bridge.gap import arrivals, command, firmware_loop, kinematics, odometry, replay, sightings
from swift_sim_bridge.gap.check import Recording
from swift_sim_bridge.gap.correction import accelerometer_errors, correct, of_gyro, of_motion
from swift_sim_bridge.gap.effect import Effect, inject
from swift_sim_bridge.gap.filters import Filter, apply, averaged, derivative, lagged, over_batch
from swift_sim_bridge.gap.kinematics import Kinematics
from swift_sim_bridge.physics import battery
from swift_sim_bridge.physics.state import parameters_from_vehicle
from swift_sim_bridge.sensors.clock import Moving
from swift_sim_bridge.sensors.terms import sensor_terms

AXES = "xyz"
RESTS_ON = {"vio": ("p_vio", "q_vio_body"), "voltage": ("voltage", "current"),
            "electrical power": ("voltage", "current")}  # by name of a channel, or layer: what may begin late or pause
GATES = ("largest gate", "next gate")[: sightings.SLOTS]


@dataclass(frozen=True)
class Channel:
    """One residual. layer: motor, force, moment, imu, camera, vio or command; name and unit: for a reader; least: what
    nobody cares for."""

    layer: str
    name: str
    unit: str
    least: float = 0.0


def channels_of(recording: Recording) -> tuple[Channel, ...]:
    """Return the residuals that the recording's channels allow."""
    found = []
    pose, imu = recording.has("p_world", "q_world_body", "gyro_body"), recording.has("specific_force_body")
    if recording.drive is not None:
        found += [Channel("motor", f"rotor {i + 1} speed", "rad/s") for i in range(recording.rotor_speed.shape[1])]
    if recording.has("voltage", "rotor_speed"):
        found += [Channel("motor", "voltage", "V")]
    if recording.has("voltage", "rotor_speed", "current"):
        found += [Channel("motor", "electrical power", "W")]
    if pose and imu and recording.has("rotor_speed"):
        found += [Channel("force", f"specific force {axis}", "m/s^2") for axis in AXES]
    if pose and recording.has("single_rotor_speeds"):
        found += [Channel("moment", f"angular acceleration {axis}", "rad/s^2") for axis in AXES]
    if pose and imu:
        found += [Channel("imu", f"pose's less accelerometer's force {axis}", "m/s^2") for axis in AXES]
    if pose:
        found += [Channel("imu", f"pose's less gyro's rate {axis}", "rad/s") for axis in AXES]
    if pose and recording.has("sightings"):
        found += [Channel("camera", f"{corner} corner of the {gate}, {axis}", "px") for gate in GATES
                  for corner in sightings.CORNERS for axis in ("across", "down")]
    if pose and recording.has("p_vio", "q_vio_body"):
        found += [Channel("vio", f"VIO's less the pose's velocity {axis}", "m/s") for axis in AXES]
    if recording.heard:
        found += [Channel("command", f"{name} heard less sent", unit, least)
                  for (name, unit), least in zip(command.UNITS.items(), arrivals.LEAST, strict=True)]
    if recording.rate_loop:
        found += [Channel("command", f"{axis} demand of the rate loop", "", firmware_loop.LEAST)
                  for axis in firmware_loop.AXES]
    return tuple(found)


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
        return {name: replay.parameters_of(some) for name, some in (sets | {"centre": [self.vehicles[0]]}).items()}

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
class Replayer:
    """Residuals of one recording for variants of a vehicle. own: effects with their values, by which the vehicle was
    other in this recording than in others."""

    recording: Recording
    own: tuple[tuple[Effect, np.ndarray], ...] = ()

    @cached_property
    def filter(self) -> Filter:
        return Filter(len(self.recording.t), self.recording.dt)

    @cached_property
    def t(self) -> np.ndarray:
        """Times (m,) s of the residuals."""
        return self.recording.t[self.filter.rows]

    @cached_property
    def channels(self) -> tuple[Channel, ...]:
        return channels_of(self.recording)

    @cached_property
    def good(self) -> np.ndarray:
        """The residuals (m,) that rest on measurements alone, in flight: the same ones whatever vehicle is tried."""
        bad = ~(self.recording.good & self.recording.flown)
        return np.asarray(self.filter.whole @ bad.astype(float)).ravel() < 0.5

    def of(self, variants: Variants) -> np.ndarray:
        """Return the residuals (b, m, c) of each variant. What a variant does not touch is taken from the first."""
        if self.own:
            variants = replace(variants, vehicles=tuple(self._as_it_was(vehicle) for vehicle in variants.vehicles))
        recording, vehicles = self.recording, variants.vehicles
        found, begin = np.empty((len(vehicles), len(self.t), len(self.channels))), 0

        def put(values, rows: list[int]) -> np.ndarray:
            """Write the next channels: values (k, m, c) to their rows, the first everywhere else; return them all."""
            nonlocal begin
            into = found[:, :, begin : begin + values.shape[-1]]
            into[:], begin = values[:1], begin + values.shape[-1]
            into[rows] = values
            return into

        if recording.drive is not None:
            put(self._motors(variants.parameters("motor")), variants.rows("motor"))
        if recording.has("voltage", "rotor_speed"):
            pack = [(vehicle.battery, vehicle.torque_coefficient) for vehicle in vehicles]
            rows = [i for i in variants.rows("motor", "motion") if not i or pack[i] != pack[0]]
            put(self._pack([vehicles[i] for i in rows]), rows)
        if recording.has("p_world", "q_world_body", "gyro_body"):
            terms = variants.sensors[0]
            seen = kinematics.of(recording, correct(recording, terms), self.filter)
            driven = self._driven(variants.parameters("motion"), seen)
            whole = put(self._motion(driven, seen, terms), variants.rows("motion"))
            for i in variants.rows("imu")[1:]:
                others = variants.sensors[i]
                if of_motion(others) == of_motion(terms):  # what turns and moves is seen alike: driven alike
                    own, drive = seen, tuple(part[:1] for part in driven)
                else:
                    gyro = seen.gyro_body if of_gyro(others) == of_gyro(terms) else None
                    own = kinematics.of(recording, correct(recording, others, gyro), self.filter)
                    drive = self._driven(variants.parameters("centre"), own)
                whole[i] = self._motion(drive, own, others)[0]
            columns = [c for c, channel in enumerate(self.channels) if channel.layer == "camera"]
            for i in variants.rows("camera")[1:]:
                found[i][:, columns] = self._gates(seen.moving, variants.sensors[i])
        if recording.heard:
            rows = variants.rows("command")
            put(self._commands([vehicles[i].terms for i in rows]), rows)
        if recording.rate_loop:
            rows = variants.rows("command")
            put(self._demands([vehicles[i] for i in rows]), rows)
        for i, rows in self._unheard.items():
            found[:, rows, i] = 0.0
        return found

    def against(self, vehicle: Vehicle) -> np.ndarray:
        """Return the residuals (m, c) of one vehicle."""
        return self.of(Variants((vehicle,), ("",)))[0]

    def _as_it_was(self, vehicle: Vehicle) -> Vehicle:
        for effect, values in self.own:
            vehicle = inject(vehicle, effect, values)
        return vehicle

    def _motors(self, parameters) -> np.ndarray:
        drive = self.recording.drive
        apart = drive.rotor_speed - replay.rotor_speeds(parameters, drive)
        at_grid = np.stack([[np.interp(self.recording.t, drive.t, rotor) for rotor in one.T] for one in apart])
        return np.moveaxis(apply(self.filter.smooth, np.moveaxis(at_grid, -1, 0)), 0, 1)

    def _commands(self, terms: list[dict]) -> np.ndarray:
        """Return what the rate loop heard less what was sent (b, m, 4)."""
        line = self.recording.heard
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
        mean = np.stack([np.interp(end, stamps, column) - np.interp(begin, stamps, column) for column in total.T],
                        axis=-1) / recording.dt  # fmt: skip
        return np.moveaxis(apply(self.filter.smooth, mean.reshape(len(mean), len(apart), -1)), 1, 0)

    def _pack(self, vehicles: list[Vehicle]) -> np.ndarray:
        """Return voltage and, with a measured current, power (b, m, 1 or 2), each about its mean: how full the pack was
        at the start is not known."""
        recording, found = self.recording, []
        cubed = np.sum(recording.rotor_speed**3, axis=1)
        heard = ~recording.hole(*RESTS_ON["voltage"])
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
        inputs = replay.Inputs(moving.p_world, moving.q_world_body, moving.v_world, gyro, recording.rotor_speed, slope)
        force, turn = replay.forces(parameters, inputs)
        return force, turn if recording.has("single_rotor_speeds") else measured_turn

    def _motion(self, driven, seen: Kinematics, terms: dict) -> np.ndarray:
        """Return the residuals of force, moment and of the instruments among themselves (b, m, k); driven: see
        `_driven`."""
        recording, low, gyro = self.recording, self.filter, seen.gyro_body
        (force, turn), batch = driven, len(driven[0])
        parts, shift = [], np.zeros((1, *gyro.shape))
        if recording.has("rotor_speed"):
            if recording.has("specific_force_body"):
                shift = accelerometer_errors(recording, terms, gyro, force, turn)
                measured = recording.specific_force_body - shift
                parts.append(over_batch(low.smooth, measured - force))
            if recording.has("single_rotor_speeds"):
                parts.append(seen.turn_acceleration - over_batch(low.smooth, turn))
        elif recording.has("specific_force_body"):
            shift = accelerometer_errors(recording, terms, gyro, force[:1], turn[:1])
        if recording.has("specific_force_body"):
            q = np.broadcast_to(seen.moving.q_world_body, (*shift.shape[:-1], 4))
            world = geometry.rotate(q, recording.specific_force_body - shift)
            between = seen.acceleration + [0.0, 0.0, GRAVITY] - over_batch(low.twice, world)
            middle = np.broadcast_to(seen.q_world_body, (*between.shape[:-1], 4))
            parts.append(np.broadcast_to(geometry.rotate_inverse(middle, between), (batch, *between.shape[1:])))
        parts.append(np.broadcast_to(seen.turning, (batch, len(low.rows), 3)))
        if recording.has("sightings"):
            gates = self._gates(seen.moving, terms)
            parts.append(np.broadcast_to(gates, (batch, *gates.shape)))
        if recording.has("p_vio", "q_vio_body"):
            parts.append(np.broadcast_to(self._odometry(seen, terms), (batch, len(low.rows), 3)))
        return np.concatenate(parts, axis=-1)

    @cached_property
    def _unheard(self) -> dict[int, np.ndarray]:
        """When (m,) there was no measurement to compare, by channel of those that have such times."""
        recording, found = self.recording, {}
        for i, channel in enumerate(self.channels):
            hole = recording.hole(*RESTS_ON.get(channel.name, RESTS_ON.get(channel.layer, ())))
            if channel.layer == "motor":  # averaged over a second
                hole = averaged(hole[:, None].astype(float), recording.dt)[:, 0] > 1e-9
            if hole.any():
                found[i] = np.asarray(self.filter.whole @ hole.astype(float)).ravel() > 0.5
        return found

    @cached_property
    def seen_at(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Which sightings (k,) are compared, and the row (k,) and slot (k,) of the residuals where each stands."""
        row, rank = self.recording.sightings.places(self.t)
        kept = np.flatnonzero(rank < sightings.SLOTS)
        return kept, row[kept], rank[kept]

    @cached_property
    def measured(self) -> np.ndarray:
        """Where (m, c) there is anything to compare: gates are in few images, VIO and the pack's meters may begin late
        or pause, all else is always there."""
        there = np.ones((len(self.t), len(self.channels)), bool)
        columns = [c for c, channel in enumerate(self.channels) if channel.layer == "camera"]
        if columns:
            _, row, slot = self.seen_at
            seen = np.zeros((len(self.t), sightings.SLOTS), bool)
            seen[row, slot] = True
            there[:, columns] = np.repeat(seen, 8, axis=1)
        for i, rows in self._unheard.items():
            there[rows, i] = False
        return there

    def _gates(self, moving: Moving, terms: dict) -> np.ndarray:
        """Return detected less projected corners (m, 8 a slot) px at the row nearest to each image, zero elsewhere."""
        kept, row, slot = self.seen_at
        apart = self.recording.sightings.residual(self.recording.t, moving, terms)[kept]
        found = np.zeros((len(self.t), sightings.SLOTS, 8))
        found[row, slot] = apart.reshape(len(kept), 8)
        return found.reshape(len(self.t), -1)

    @cached_property
    def _v_vio(self) -> np.ndarray:
        """VIO's velocity (m, 3) m/s in the body as it sees it."""
        told = apply(self.filter.slope, self.recording.p_vio)
        return geometry.rotate_inverse(self.recording.q_vio_body[self.filter.rows], told)

    def _odometry(self, seen: Kinematics, terms: dict) -> np.ndarray:
        """Return VIO's less the pose's velocity (m, 3) m/s, each in the body as it sees it: so no common frame is
        needed."""
        q = seen.q_world_body
        return self._v_vio - geometry.rotate_inverse(q, odometry.velocity(q, seen.v_world, terms))
