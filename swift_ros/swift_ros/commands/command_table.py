"""Table of all commands of `swiftros`. Plain data: `setup.py` runs this file before anything is installed."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Command:
    """One command.

    Attributes:
        name: as typed after `swiftros`.
        module: Python module with the function `command` that adds its parser.
    """

    name: str
    module: str

    @property
    def package(self) -> str:
        """Package that installs the command."""
        return self.module.partition(".")[0]

    @property
    def entry_point(self) -> str:
        """Line for the entry-point group `swift.commands` of the package's `setup.py`."""
        return f"{self.name} = {self.module}:command"


COMMANDS = (
    Command("calibration", "swift_ros.commands.calibration"),
    Command("check", "swift_ros.commands.check"),
    Command("import", "swift_ros.commands.import_recording"),
    Command("record", "swift_ros.commands.record"),
    Command("recover", "swift_ros.commands.recover"),
    Command("replay", "swift_ros.commands.replay"),
    Command("topics", "swift_ros.commands.topics"),
    Command("bench", "swift_sim_bridge.commands.bench"),
    Command("evaluate", "swift_sim_bridge.commands.evaluate"),
    Command("faults", "swift_sim_bridge.commands.faults"),
    Command("gap", "swift_sim_bridge.commands.gap"),
    Command("gap-referee", "swift_sim_bridge.commands.gap_referee"),
    Command("identify", "swift_sim_bridge.commands.identify"),
    Command("label", "swift_sim_bridge.commands.label"),
    Command("limit", "swift_sim_bridge.commands.limit"),
    Command("race", "swift_sim_bridge.commands.race"),
    Command("sim", "swift_sim_bridge.commands.sim"),
    Command("soak", "swift_sim_bridge.commands.soak"),
    Command("train", "swift_sim_bridge.commands.train"),
    Command("video", "swift_sim_bridge.commands.video"),
    Command("view", "swift_sim_bridge.commands.view"),
)
