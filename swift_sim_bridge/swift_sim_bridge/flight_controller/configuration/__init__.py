"""The configuration of the simulated flight controller, from the vehicle file's `controller` section.

cli_settings: settings of Betaflight's CLI: defaults, ranges, which are simulated.
cli_dump: parser of CLI dumps.
controller_section: the `controller` section, by keys or by a CLI dump.
rates: rate curves and throttle range.
dump_profile: the rate loop's profile from a CLI dump.
vehicle_profile: the rate loop's profile from a vehicle file.
"""
