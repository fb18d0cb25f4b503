"""What a diagnosis changes in the vehicle file: each parameter's value before, its key, and what limits its meaning."""

from swift_ros.recording.flight_table import FlightTable
from swift_ros.vehicle import Vehicle
from swift_sim_bridge.effects import Effect, Parameter
from swift_sim_bridge.gap.effects.injection import file_values
from swift_sim_bridge.gap.effects.patch import key_of
from swift_sim_bridge.gap.recording.channel_names import names_with_columns
from swift_sim_bridge.gap.report.quantities import significant

IMAGES = "camera"  # layer whose rows are images, which have exact stamps


def with_changes(report: dict, diagnosis, vehicle: Vehicle, tables: list[FlightTable]) -> dict:
    """Return a report in which each parameter of an effect has `was` and `key`, and each finding has a `caution`.

    Args:
        report: content of report.json.
        diagnosis: a `gap.pipeline.diagnosis.Diagnosis`.
        vehicle: the vehicle before the repair.
        tables: the recordings.
    """
    effects = {(one.effect.id, one.effect.variant): one.effect for one in diagnosis.selected}
    # wind belongs to one flight and is not among the vehicle's
    effects |= {(one.effect.id, one.effect.variant): one.effect for own in diagnosis.own_effects for one in own}
    return report | {
        "recordings": [_recording(table) for table in tables],
        "findings": [
            _with_changes(one, effects[one["effect"], one["variant"]], vehicle, tables)
            if (one["effect"], one["variant"]) in effects
            else one
            for one in report["findings"]
        ],
    }


def _recording(table: FlightTable) -> dict:
    """Return the entry of a recording: its name, duration and the rate of each channel."""
    begin, end = table.span_s
    rates = {name: samples.rate_hz for name, samples in table.channels.items() if len(samples.t) > 1}
    return {"name": table.name, "seconds": end - begin, "rows_per_second": rates}


def _with_changes(finding: dict, effect: Effect, vehicle: Vehicle, tables: list[FlightTable]) -> dict:
    """Return a finding with the entries of its effect's parameters completed."""
    entries, cautions = dict(finding["parameters"]), []
    for parameter, before in zip(effect.parameters, file_values(effect, vehicle), strict=True):
        path = parameter.path
        is_new = path[0] == "terms" and path[1] not in vehicle.terms
        entry = {"was": None if is_new else float(before), "key": key_of(path)}
        entries[parameter.name] = entries[parameter.name] | entry
        cautions.append(_below_one_row(parameter, effect, entries[parameter.name]["value"] - float(before), tables))
    return finding | {"parameters": entries, "caution": " ".join(filter(None, cautions))}


def _below_one_row(parameter: Parameter, effect: Effect, change: float, tables: list[FlightTable]) -> str:
    """Return a sentence where a change in time is smaller than the time between two rows; "" elsewhere."""
    if parameter.unit != "s" or effect.layer == IMAGES or not change:
        return ""
    rates = {
        name: min(table[name].rate_hz for table in tables)
        for name in effect.channels
        if all(name in table for table in tables)
    }
    slowest = min(rates, key=rates.__getitem__, default=None)
    if slowest is None or abs(change) * rates[slowest] >= 1.0:
        return ""
    return (
        f"This shift of {significant(1e3 * abs(change))} ms is shorter than a row of the recording "
        f"({significant(1e3 / rates[slowest])} ms): rows that are averaged, held or stamped late look the same. To be "
        f"sure, log {names_with_columns([slowest])} at {significant(1.0 / abs(change))} rows a second or more."
    )
