"""The hypotheses of a search: the effects that the recordings can show, and why the others cannot be tested."""

from dataclasses import dataclass

from swift_ros.vehicle import Vehicle
from swift_sim_bridge.effects import Effect
from swift_sim_bridge.gap.attribution import payload
from swift_sim_bridge.gap.effects.catalogue import catalogue, not_identified
from swift_sim_bridge.gap.inference.sensitivity import parameter_slices, perturbed_variants
from swift_sim_bridge.gap.recording.channel_names import PHYSICS, missing_channels, names_with_columns, unmeasured
from swift_sim_bridge.gap.report import effect_help
from swift_sim_bridge.gap.residuals.variants import Variants

OF_EACH_COMMAND = ("command_jitter", "dropped_commands")  # effects that are found from the time of each command


@dataclass(frozen=True)
class Hypotheses:
    """The effects that the recordings' channels can show.

    Attributes:
        effects: effects to search for.
        knocked_out: effects that are not searched for, but whose minimum detectable magnitudes are reported.
        untestable: why the other effects cannot be tested, by id.
        variants: variants of the vehicle, by which `effects` are linearised.
        rows: slice of each effect's parameters, by key.
        excluded: ids of all effects that are not searched for in these recordings together.
        physics: ids of all effects of motors, forces and moments that the vehicle may have.
    """

    effects: tuple[Effect, ...]
    knocked_out: tuple[Effect, ...]
    untestable: dict[str, str]
    variants: Variants
    rows: dict[str, slice]
    excluded: frozenset[str]
    physics: frozenset[str]


def hypotheses_of(vehicle: Vehicle, recordings, knocked_out, per_flight) -> Hypotheses:
    """Return the effects to search for.

    Args:
        vehicle: the vehicle that the recordings are compared with.
        recordings: `recording.Recording` objects.
        knocked_out: ids of effects that are left out of the search.
        per_flight: ids of effects that are searched for in each recording alone.
    """
    known_effects, untestable = testable(vehicle, recordings)
    excluded = {*knocked_out, *per_flight}
    effects = tuple(effect for effect in known_effects if effect.id not in excluded)
    removed = tuple(effect for effect in known_effects if effect.id in excluded.difference(per_flight))
    variants = perturbed_variants(vehicle, effects, central=False)
    physics = frozenset(effect.id for effect in catalogue(vehicle) if effect.layer in PHYSICS)
    return Hypotheses(effects, removed, untestable, variants, parameter_slices(effects), frozenset(excluded), physics)


def testable(vehicle: Vehicle, recordings) -> tuple[tuple[Effect, ...], dict[str, str]]:
    """Return the effects that the recordings' channels can show, and by id why the others cannot be tested.

    Args:
        vehicle: the vehicle that the recordings are compared with.
        recordings: `recording.Recording` objects.
    """
    found, known = [], catalogue(vehicle, gates_of(recordings))
    untestable = {name: effect.reason for name, effect in not_identified().items()}
    for effect in known:
        missing = missing_channels(effect, recordings)
        if effect.layer == "command" and missing:
            untestable[effect.id] = _command_reason(missing, recordings)
        elif effect.id in OF_EACH_COMMAND and (row_s := _longest_row_s(recordings)):
            untestable[effect.id] = (
                f"rows {1e3 * row_s:.0f} ms apart miss commands; record rows more often than commands are sent"
            )
        elif effect.layer == "camera" and missing:
            untestable[effect.id] = "the recording has no gates in images, or no pose from where they were seen"
        elif missing:
            untestable[effect.id] = f"the recording lacks {names_with_columns(unmeasured(missing, recordings))}"
        elif effect.id == "clock_drift" and any(one.one_clock for one in recordings):
            untestable[effect.id] = "all channels of the recording have the stamps of one clock"
        else:
            found.append(effect)
    part = next((part for part in payload.PARTS if part in untestable), None)  # a payload is found by these effects
    if part:
        untestable["payload"] = untestable[part]
    if "wind" in untestable:
        untestable |= dict.fromkeys(("gust", "local_draught"), untestable["wind"])
    return tuple(found), untestable | effect_help.missing_terms(vehicle)


def _longest_row_s(recordings) -> float:
    """Return the longest time between two rows of recordings that lack some of the commands; 0 if none does."""
    links = [one.command_link for one in recordings if one.command_link]
    return max((link.row_s for link in links if not link.is_complete), default=0.0)


def _command_reason(missing, recordings) -> str:
    """Return why the command link, or the rate loop where that is missing, cannot be tested."""
    evidence = "rate_loop" if "rate_loop" in missing else "command_link"
    recording = next(one for one in recordings if evidence in one.unavailable)
    unavailable = recording.unavailable[evidence]
    if not unavailable.missing:
        return unavailable.reason
    return f"the recording lacks {names_with_columns(unmeasured(unavailable.missing, [recording]))}"


def gates_of(recordings) -> int:
    """Return the number of gates of the map that the recordings share; 1 where there is no map, as an example."""
    maps = [one.gate_observations.track for one in recordings if one.gate_observations]
    return len(maps[0].gates) if maps else 1
