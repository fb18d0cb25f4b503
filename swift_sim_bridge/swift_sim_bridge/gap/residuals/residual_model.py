"""All residuals of one recording, for many variants of a vehicle at once.

Each layer has measured inputs, so that the error of one layer does not enter the next. The errors of the sensors are
removed from the measurements first (`sensor_correction`). Both sides of every equation pass the same filter
(`filters`), and no measurement is compared with its own derivative.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import chain
from typing import NamedTuple

import numpy as np

from swift_ros.recording.flight_table import Samples
from swift_ros.vehicle import Vehicle
from swift_sim_bridge.effects import Effect
from swift_sim_bridge.gap.effects.injection import inject
from swift_sim_bridge.gap.recording.command_rows import CommandRows
from swift_sim_bridge.gap.recording.recording import Recording, at_times_of_recording
from swift_sim_bridge.gap.residuals import camera, commands, odometry, physics_replay, propulsion, rigid_body
from swift_sim_bridge.gap.residuals.channels import ELECTRICAL_POWER, VOLTAGE, Channel, residual_groups
from swift_sim_bridge.gap.residuals.filters import Filter, averaged
from swift_sim_bridge.gap.residuals.kinematics import Kinematics, compute_kinematics
from swift_sim_bridge.gap.residuals.rigid_body import Wrench
from swift_sim_bridge.gap.residuals.sensor_correction import (
    OF_ACCELEROMETER,
    OF_GYRO,
    OF_VIO,
    correct,
    differing,
    terms_of,
)
from swift_sim_bridge.gap.residuals.variants import Variants

DEPENDS_ON = {  # by quantity or layer of a residual: the channels that may begin late or pause
    "vio": ("p_vio", "q_vio_body"),
    "motor": ("motor_command", "voltage"),
    VOLTAGE: propulsion.BATTERY_CHANNELS,
    ELECTRICAL_POWER: propulsion.BATTERY_CHANNELS,
}


# Of the size of force or moments. Beyond it a channel shows no equation, and a moment does not judge a repair.
MAX_COUNTED_SPREAD = 0.1
UNLIMITED = 1e6  # standard deviations of the noise: a nuisance that the residuals do not limit


class RotorSpread(NamedTuple):
    """What commands in slow rows leave open of the rotors' force along z and their moments.

    `inference.row_sampling` estimates it.

    Attributes:
        size: (4,) standard deviations of the relative size of what they vary by.
        mean: (4,) standard deviations of their means, m/s^2 and rad/s^2.
        noise: (4,) upper bounds of the noise of the motion, in the same units: noise of the commands is no part of it.
    """

    size: tuple[float, ...]
    mean: tuple[float, ...]
    noise: tuple[float, ...]


@dataclass(frozen=True)
class ResidualModel:
    """Computes the residuals of one recording.

    Attributes:
        recording: the recording.
        flight_effects: effects with their values that the vehicle had in this recording alone.
        excluded_groups: groups of channels that are not compared.
        rotor_spread: what is open of the rotors' force along z and their moments; None where they are those of the
            vehicle.
    """

    recording: Recording
    flight_effects: tuple[tuple[Effect, np.ndarray], ...] = ()
    excluded_groups: frozenset[str] = frozenset()
    rotor_spread: RotorSpread | None = None

    @cached_property
    def filter(self) -> Filter:
        """The filter of the residuals."""
        return Filter(len(self.recording.t), self.recording.dt)

    @cached_property
    def t(self) -> np.ndarray:
        """Times (m,) s of the residuals."""
        return self.recording.t[self.filter.rows]

    @cached_property
    def groups(self) -> dict[str, tuple[Channel, ...]]:
        """The channels by group."""
        groups = residual_groups(self.recording).items()
        return {name: channels for name, channels in groups if name not in self.excluded_groups}

    @cached_property
    def channels(self) -> tuple[Channel, ...]:
        """All channels (c,)."""
        return tuple(chain.from_iterable(self.groups.values()))

    @cached_property
    def columns(self) -> dict[str, slice]:
        """The positions of each group's channels among all."""
        ends = np.cumsum([len(group) for group in self.groups.values()])
        return {name: slice(end - len(self.groups[name]), end) for name, end in zip(self.groups, ends, strict=True)}

    @cached_property
    def good(self) -> np.ndarray:
        """The residuals (m,) that depend on measured samples in flight alone; the same for all vehicles."""
        bad = ~(self.recording.good & self.recording.flown)
        return np.asarray(self.filter.support @ bad.astype(float)).ravel() < 0.5

    @cached_property
    def measured(self) -> np.ndarray:
        """Where (m, c) a residual exists: few images show a gate, and some channels begin late or pause."""
        found = np.ones((len(self.t), len(self.channels)), bool)
        if columns := self.columns.get("camera"):
            found[:, columns] = camera.compared_times(self.compared_gates, len(self.t))
        for i, rows in self._gaps.items():
            found[rows, i] = False
        return found

    @cached_property
    def counted(self) -> np.ndarray:
        """Where (m, c) a residual counts for or against a repair: where it exists, but for moments of open size."""
        found = self.measured.copy()
        if self.rotor_spread:
            found[:, np.intersect1d(self.open_columns, np.r_[self.columns["moment"]])] = False
        return found

    @property
    def open_columns(self) -> np.ndarray:
        """The channels of the rotors' force and moments whose size commands in slow rows leave open."""
        if not self.rotor_spread:
            return np.array([], int)
        return self.rotor_columns[np.array(self.rotor_spread.size) > MAX_COUNTED_SPREAD]

    @cached_property
    def compared_gates(self) -> camera.ComparedGates:
        """The gate observations that are compared."""
        return camera.compared_gates(self.recording, self.t)

    def residual(self, vehicle: Vehicle) -> np.ndarray:
        """Return the residuals (m, c) for one vehicle."""
        return self.residuals(Variants((vehicle,), ("",)))[0]

    def rotor_speed(self, vehicle: Vehicle) -> np.ndarray:
        """Return the rotor speeds (n, r) rad/s of one vehicle: as measured, or driven by the recorded commands."""
        found = self._rotor_speeds(Variants((self._with_flight_effects(vehicle),), ("",)))
        return found.reshape(found.shape[-2:])

    def residuals(self, variants: Variants) -> np.ndarray:
        """Return the residuals (b, m, c) for b variants. A variant shares with the first what it does not change."""
        if self.flight_effects:
            vehicles = tuple(self._with_flight_effects(vehicle) for vehicle in variants.vehicles)
            variants = replace(variants, vehicles=vehicles)
        computed = [part for part in self._computed(variants) if part[0] in self.groups]
        first = {group: values[0] for group, rows, values in computed if rows[0] == 0}
        first = np.concatenate([first[group] for group in self.groups], axis=-1)
        found = np.repeat(first[None], len(variants.vehicles), axis=0)
        for group, rows, values in computed:
            found[:, :, self.columns[group]][rows] = values
        for i, rows in self._gaps.items():
            found[:, rows, i] = 0.0
        return found

    @property
    def command_rows(self) -> CommandRows | None:
        """The motor commands, where their rows are slower than the loop."""
        record = self.recording.driven or self.recording.motor_record
        return record.rows if record is not None and len(self.driven_columns) else None

    @cached_property
    def driven_columns(self) -> np.ndarray:
        """The channels (k,) whose residuals depend on what motor commands did between their rows."""
        groups = ("force", "moment") if self.recording.driven else ("rotors",)
        ranges = [np.r_[self.columns[name]] for name in groups if name in self.columns]
        return np.concatenate([np.array([], int), *ranges])

    def with_command_rows(self, rows: CommandRows) -> "ResidualModel":
        """Return the residual model with other motor commands between the rows."""
        return replace(self, recording=self.recording.with_motor_rows(rows))

    def row_sensitivity(self, vehicle: Vehicle) -> np.ndarray:
        """Return the change (3, m, k) of the residuals in `driven_columns` per standard deviation of the rows."""
        rows = self.command_rows
        if not self.recording.driven:
            parameters = physics_replay.stack_parameters([self._with_flight_effects(vehicle)])
            return propulsion.row_sensitivity(self.recording, self.filter, parameters)
        found = np.zeros((len(rows.sigma), len(self.t), len(self.driven_columns)))
        for i in np.flatnonzero(rows.sigma):
            step = np.zeros(len(found))
            step[i] = propulsion.NUISANCE_STEPS[i]
            later, earlier = (self.with_command_rows(rows.moved(*one)).residual(vehicle) for one in (step, -step))
            found[i] = rows.sigma[i] * (later - earlier)[:, self.driven_columns] / (2.0 * step[i])
        return found

    def nuisance(self, vehicle: Vehicle) -> np.ndarray:
        """Return the change (k, m, c) of the residuals per standard deviation of k nuisance parameters, over the noise.

        The parameters are those of motor commands in slow rows, size and mean of force and moments under these, the
        times of commands and gyro in these rows, and, of unlimited variance, the state of the battery at the first row.
        """
        found = [self._of_commands]
        if self.rotor_spread:
            found.append(self._of_rotors(vehicle))
        if "pack" in self.groups:
            change = propulsion.pack_start_sensitivity(self.recording, self.filter, self._with_flight_effects(vehicle))
            of_pack = np.zeros((*change.shape, len(self.channels)))
            of_pack[:, :, self.columns["pack"].start] = UNLIMITED * change
            found.append(of_pack)
        if self.command_rows is not None:
            found.append(self._of_rows(vehicle))
        total = np.concatenate(found)
        for i, rows in self._gaps.items():
            total[:, rows, i] = 0.0
        total[:, ~self.good] = 0.0
        return total

    @cached_property
    def _of_commands(self) -> np.ndarray:
        """The change (k, m, c) per standard deviation of the time between commands or gyro and rows, over the noise."""
        link, columns = self.recording.command_link, self.columns.get("command")
        found = np.zeros((5 if columns and link.row_s else 0, len(self.t), len(self.channels)))
        if len(found):
            residual = commands.command_residuals(self.recording, self.filter, [{}])[0][self.good]
            noise = np.std(np.diff(residual, axis=0), axis=0) / np.sqrt(2.0)
            floor = [channel.negligible for channel in self.groups["command"]]
            change = commands.timing_sensitivity(self.recording, self.filter)
            found[:, :, columns] = change / np.maximum(noise, floor)
        return found

    @property
    def rotor_columns(self) -> np.ndarray:
        """The channels (4,) of the rotors: force along z and the moments."""
        return np.r_[self.columns["force"].stop - 1, self.columns["moment"]]

    def modelled_rotors(self, vehicle: Vehicle) -> np.ndarray:
        """Return what one vehicle has in `rotor_columns` (m, 4): m/s^2 and rad/s^2, filtered as the measured ones."""
        variants = Variants((self._with_flight_effects(vehicle),), ("",))
        corrected = correct(self.recording, variants.sensors[0])
        kinematics = compute_kinematics(self.recording, corrected, self.filter)
        parameters, speeds = variants.parameters("motion", "motor"), self._rotor_speeds(variants)
        wrench = rigid_body.modelled_wrench(self.recording, kinematics, parameters, speeds)
        force = rigid_body.filtered_force(self.filter, kinematics, wrench)[0, :, 2:]
        return np.concatenate([force, rigid_body.filtered_turn(self.recording, self.filter, wrench)[0]], axis=1)

    def _of_rows(self, vehicle: Vehicle) -> np.ndarray:
        """The change (k, m, c) per standard deviation of the rows' parameters, over the noise.

        Forces and moments have different noise. Each has parameters of its own, which leaves more open than one set.
        """
        change, columns = self.row_sensitivity(vehicle) / self.command_rows.noise, self.driven_columns
        alone = columns[:, None] if self.recording.driven else columns[None]
        found = np.zeros((len(alone), len(change), len(self.t), len(self.channels)))
        for own, of_own in zip(alone, found, strict=True):
            of_own[:, :, own] = change[:, :, np.searchsorted(columns, own)]
        return found.reshape(-1, *found.shape[2:])

    def _of_rotors(self, vehicle: Vehicle) -> np.ndarray:
        """The change (8, m, c) per standard deviation of size and mean of force and moments, over the noise."""
        modelled, columns = self.modelled_rotors(vehicle), self.rotor_columns
        noise = np.broadcast_to(self.command_rows.noise, len(self.driven_columns))
        noise = np.minimum(noise[np.searchsorted(self.driven_columns, columns)], self.rotor_spread.noise)
        varying = np.where(self.good[:, None], modelled - modelled[self.good].mean(axis=0), 0.0)
        found, each = np.zeros((2, len(columns), len(self.t), len(self.channels))), np.arange(len(columns))
        found[0, each, :, columns] = (varying * self.rotor_spread.size / noise).T
        found[1, each, :, columns] = (np.array(self.rotor_spread.mean) / noise)[:, None]
        return found.reshape(-1, *found.shape[2:])

    def _with_flight_effects(self, vehicle: Vehicle) -> Vehicle:
        """Return the vehicle as it was in this recording."""
        for effect, values in self.flight_effects:
            vehicle = inject(vehicle, effect, values)
        return vehicle

    def _computed(self, variants: Variants) -> Iterator[tuple[str, list[int], np.ndarray]]:
        """Yield groups of channels, the k variants that change them, and their residuals (1 or k, m, channels).

        The first yield of a group includes the first variant.
        """
        recording, low, vehicles = self.recording, self.filter, variants.vehicles
        if recording.motor_record is not None:
            residuals = propulsion.rotor_speed_residuals(recording, low, variants.parameters("motor"))
            yield "rotors", variants.rows("motor"), residuals
        if recording.has("voltage", "rotor_speed"):
            pack = [(one.battery, one.torque_coefficient, one.terms.get("equation")) for one in vehicles]
            rows = [i for i in variants.rows("motor", "motion") if not i or pack[i] != pack[0]]
            yield "pack", rows, propulsion.battery_residuals(recording, low, [vehicles[i] for i in rows])
        if recording.has_motion:
            yield from self._with_pose(variants)
        if recording.command_link:
            rows = variants.rows("command")
            yield "command", rows, commands.command_residuals(recording, low, [vehicles[i].terms for i in rows])
        if recording.rate_loop:
            rows = variants.rows("command")
            yield "rate loop", rows, commands.rate_loop_residuals(recording, low, [vehicles[i] for i in rows])

    def _with_pose(self, variants: Variants) -> Iterator[tuple[str, list[int], np.ndarray]]:
        """Yield the groups that are compared with the pose, as `_computed` does."""
        recording, terms = self.recording, variants.sensors[0]
        changes = ("motion", "motor") if recording.driven else ("motion",)
        kinematics = compute_kinematics(recording, correct(recording, terms), self.filter)
        speeds = self._rotor_speeds(variants)
        wrench = rigid_body.modelled_wrench(recording, kinematics, variants.parameters(*changes), speeds)
        for group, values in self._motion(kinematics, wrench, terms).items():
            yield group, variants.rows(*changes), values
        yield from self._for_other_sensors(variants, kinematics, Wrench(*(part[:1] for part in wrench)))
        for i in variants.rows("camera")[1:]:
            for group, values in self._camera(kinematics, variants.sensors[i]).items():
                yield group, [i], values

    def _rotor_speeds(self, variants: Variants) -> np.ndarray | None:
        """Return the rotor speeds (n, r) rad/s; (b, n, r) of each variant where these are driven by the commands."""
        record, t = self.recording.driven, self.recording.t
        if record is None:
            return self.recording.rotor_speed
        first, rows = variants.vehicles[0], variants.rows("motion", "motor")
        own = [i for i in rows if not i or variants.changes[i] == "motor" or _loads_pack(variants.vehicles[i], first)]
        parameters = physics_replay.stack_parameters([variants.vehicles[i] for i in own])
        replayed = physics_replay.rotor_speeds(parameters, record)
        on_grid = [at_times_of_recording(Samples(record.t, one), t) for one in replayed]
        return np.stack([on_grid[own.index(i) if i in own else 0] for i in rows])

    def _for_other_sensors(
        self, variants: Variants, kinematics: Kinematics, wrench: Wrench
    ) -> Iterator[tuple[str, list[int], np.ndarray]]:
        """Yield the residuals that other sensors than the camera change, as `_computed` does.

        Args:
            variants: the variants.
            kinematics: kinematics with the sensors of the first variant.
            wrench: wrench of the first variant.
        """
        moved: dict[int, Kinematics] = {}
        for i in variants.rows("imu")[1:]:
            terms = variants.sensors[i]
            changed = differing(variants.sensors[0], terms)
            if len(terms_of(OF_VIO, changed)) == len(changed):
                found = self._odometry(kinematics, terms)
            elif len(terms_of(OF_ACCELEROMETER, changed)) == len(changed):
                found = rigid_body.accelerometer_residuals(self.recording, self.filter, kinematics, wrench, terms)
            else:
                same_gyro = None if terms_of(OF_GYRO, changed) else kinematics
                corrected = correct(self.recording, terms, same_gyro.gyro_body if same_gyro else None)
                moved[i] = compute_kinematics(self.recording, corrected, self.filter, same_gyro)
                continue
            yield from ((group, [i], values) for group, values in found.items())
        if moved:
            speeds = self._rotor_speeds(Variants(variants.vehicles[:1], ("",)))
            motions = [kinematics, *moved.values()]
            changes = rigid_body.wrench_changes(self.recording, motions, variants.nominal_parameters, speeds)
            for (i, own), change in zip(moved.items(), changes, strict=True):
                changed = Wrench(*(part + by for part, by in zip(wrench, change, strict=True)))
                for group, values in self._motion(own, changed, variants.sensors[i]).items():
                    yield group, [i], values

    def _motion(self, kinematics: Kinematics, wrench: Wrench, terms: dict) -> dict[str, np.ndarray]:
        """Return all residuals that depend on the pose, by group."""
        found = rigid_body.wrench_residuals(self.recording, self.filter, kinematics, wrench, terms)
        return found | self._camera(kinematics, terms) | self._odometry(kinematics, terms)

    def _camera(self, kinematics: Kinematics, terms: dict) -> dict[str, np.ndarray]:
        """Return the residuals of the camera, nothing without one."""
        if not self.recording.has("gate_observations"):
            return {}
        gates, count = self.compared_gates, len(self.t)
        return {"camera": camera.corner_residuals(self.recording, gates, count, kinematics.moving, terms)}

    def _odometry(self, kinematics: Kinematics, terms: dict) -> dict[str, np.ndarray]:
        """Return the residuals of VIO, nothing without it."""
        if not self.recording.has("p_vio", "q_vio_body"):
            return {}
        return {"vio": odometry.velocity_residuals(self._v_vio, kinematics, self.filter, terms)}

    @cached_property
    def _v_vio(self) -> np.ndarray:
        """VIO's velocity (m, 3) m/s in the body frame."""
        return odometry.measured_velocity(self.recording, self.filter)

    @cached_property
    def _gaps(self) -> dict[int, np.ndarray]:
        """When (m,) a channel has no measurement to compare, by index of the channels that have such times."""
        recording, found = self.recording, {}
        for i, channel in enumerate(self.channels):
            gap = recording.in_gap(*DEPENDS_ON.get(channel.quantity, DEPENDS_ON.get(channel.layer, ())))
            if channel.layer == "motor":  # averaged over a second, or driven by earlier commands
                gap = averaged(gap[:, None].astype(float), recording.dt)[:, 0] > 1e-9
            if gap.any():
                found[i] = np.asarray(self.filter.support @ gap.astype(float)).ravel() > 0.5
        return found


def _loads_pack(vehicle: Vehicle, other: Vehicle) -> bool:
    """Return whether the rotors of a vehicle load its battery otherwise than those of another one."""
    return vehicle.torque_coefficient != other.torque_coefficient
