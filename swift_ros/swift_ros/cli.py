"""The `swiftros` command.

Commands are found, not listed: each package names its own in the entry-point group `swift.commands`, as
`name = package.commands.module:command`. `command(subparsers)` adds an argparse parser of that name and sets its
`run`, a function of the parsed arguments that returns the exit code. How the module's docstring begins, up to an empty
line, is what `swiftros --help` says about it. Only the module of the command given is imported, so that `topics` starts
without JAX.
"""

import argparse
import ast
import importlib.util
import os
import sys
from importlib.metadata import entry_points, version
from pathlib import Path

from swift_ros.errors import UsageError

GROUP = "swift.commands"
# the commands of swift_sim_bridge, named here only to say on a vehicle what they lack
WORKSTATION_COMMANDS = ("bench", "evaluate", "gap", "gap-referee", "identify", "race", "sim", "train")


class Parser(argparse.ArgumentParser):
    """An argument parser whose complaints are one sentence, without the usage."""

    def error(self, message):
        raise UsageError(f"{message} (`{self.prog} --help` lists what it takes)")


def main(argv: list[str] | None = None) -> int:
    """Run `swiftros ARGV` and return its exit code: the command's own, 2 on bad input, 130 when interrupted."""
    try:
        return run(sys.argv[1:] if argv is None else argv)
    except UsageError as error:
        print(f"swiftros: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        return 130
    except BrokenPipeError:
        # `swiftros topics list | head`: the reader has what it wanted; nothing may be flushed at exit
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0


def run(argv: list[str]) -> int:
    """Find the command that `argv` begins with, run it and return its exit code. Raises UsageError on bad input."""
    commands = {entry.name: entry for entry in sorted(entry_points(group=GROUP), key=lambda entry: entry.name)}
    parser = Parser(
        prog="swiftros",
        description="Fly, simulate, replay and inspect the Swift drone-racing graph.",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action="version", version=f"swiftros {version('swift_ros')}")
    if not argv or argv[0].startswith("-"):
        parser.epilog = command_table(commands)
        parser.usage = "swiftros COMMAND [options]"
        parser.parse_args(argv)
        raise UsageError("no command was given; `swiftros --help` lists them")
    entry = find(argv[0], commands)
    try:
        entry.load()(parser.add_subparsers())
        arguments = parser.parse_args(argv)
        return arguments.run(arguments)
    except ModuleNotFoundError as error:
        if not error.name or error.name.startswith("swift_"):
            raise  # a fault of ours, not of the installation
        raise UsageError(
            f"'{entry.name}' needs the Python module {error.name}, which is not installed; `make setup` "
            "installs all that Swift needs"
        ) from error


def find(name, commands):
    """The entry point of the command `name`. Raises UsageError for one that is not to be had."""
    if name in commands:
        return commands[name]
    if name in WORKSTATION_COMMANDS:
        raise UsageError(f"'{name}' belongs to the workstation package swift_sim_bridge, which is not installed here")
    raise UsageError(f"there is no command '{name}'; there are {', '.join(commands)}")


def command_table(commands):
    """One line for each command: its name and how its module's docstring begins."""
    width = max(map(len, commands), default=0)
    return "commands:\n" + "\n".join(f"  {name:<{width}}  {summary(entry.module)}" for name, entry in commands.items())


def summary(module):
    """First paragraph of a module's docstring, read without importing the module; empty where there is none."""
    spec = importlib.util.find_spec(module)
    docstring = spec and spec.origin and ast.get_docstring(ast.parse(Path(spec.origin).read_text()))
    return " ".join(docstring.partition("\n\n")[0].split()) if docstring else ""


if __name__ == "__main__":
    sys.exit(main())
