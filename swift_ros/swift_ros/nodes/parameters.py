"""Settings of a node: its section of `config/nodes.yaml`, read into a dataclass and declared as ROS parameters.

The fields of the dataclass are made by `configuration.setting`; their help and range become parameter descriptors.
"""

import dataclasses

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.exceptions import InvalidParameterTypeException, InvalidParameterValueException
from rclpy.parameter import Parameter

from swift_ros import configuration
from swift_ros.errors import UsageError


def folder(node):
    """Return the configuration folder of a node: its parameter `config`, else the default folder."""
    if not node.has_parameter("config"):
        node.declare_parameter("config", "", ParameterDescriptor(description="configuration folder", read_only=True))
    return configuration.configuration_folder(node.get_parameter("config").value or None)


def read(node, section: str, settings_type):
    """Return the settings of a node from `nodes.yaml`; a ROS parameter given at the start overrides a value.

    Args:
        node: the node.
        section: section of `nodes.yaml`.
        settings_type: dataclass of the settings.

    Raises:
        UsageError: an unknown key, a wrong type or a value outside its range.
    """
    path = folder(node) / "nodes.yaml"
    settings = configuration.load_section(settings_type, path, section)
    values = {}
    for spec in dataclasses.fields(settings_type):
        value = getattr(settings, spec.name)
        value = list(value) if isinstance(value, tuple) else value
        try:
            values[spec.name] = node.declare_parameter(spec.name, value, _descriptor(spec, value)).value
        except (InvalidParameterTypeException, InvalidParameterValueException) as error:
            raise UsageError(f"parameter '{spec.name}' of node {node.get_name()}: {error}") from error
    _refuse_unknown(node)
    return configuration.build(settings_type, values, f"parameters of node {node.get_name()}")


def _descriptor(spec, value):
    descriptor = ParameterDescriptor(description=spec.metadata.get("help", ""), read_only=True)
    limits = spec.metadata.get("range")
    if limits and type(value) is float:
        descriptor.floating_point_range = [FloatingPointRange(from_value=float(limits[0]), to_value=float(limits[1]))]
    elif limits and type(value) is int:
        descriptor.integer_range = [IntegerRange(from_value=int(limits[0]), to_value=int(limits[1]))]
    return descriptor


def _refuse_unknown(node):
    for name in node._parameter_overrides:
        if not node.has_parameter(name) and not name.startswith("qos_overrides"):
            raise UsageError(f"node {node.get_name()} has no parameter '{name}'; see its section of config/nodes.yaml")


def lockstep(node) -> bool:
    """Return whether the node runs on simulated time, in lockstep with the simulator."""
    return node.get_parameter("use_sim_time").type_ == Parameter.Type.BOOL and node.get_parameter("use_sim_time").value
