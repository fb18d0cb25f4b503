"""The command `swiftros`.

Commands are entry points of the group `swift.commands`, written as `name = package.commands.module:command`. The
function `command(subparsers)` adds an argparse parser of that name and sets its default `run`: a function of the parsed
arguments that returns the exit code. `swiftros --help` prints the first paragraph of each module's docstring. Only the
module of the requested command is imported, so that `topics` starts without JAX.

The commands of this repository are listed in `commands/command_table.py`; other packages may add their own.
"""

import argparse
import ast
import errno
import functools
import importlib.util
import os
import signal
import sys
import threading
import warnings
from collections.abc import Callable
from importlib.metadata import entry_points, version
from pathlib import Path

from swift_ros.commands import output
from swift_ros.commands.command_table import COMMANDS
from swift_ros.errors import DamagedRecording, UsageError
from swift_ros.library_threads import use_one_thread

GROUP = "swift.commands"


class Parser(argparse.ArgumentParser):
    """An argument parser that raises a UsageError of one sentence instead of printing its usage."""

    def error(self, message):
        raise UsageError(f"{message} (`{self.prog} --help` lists its arguments)")


class Terminated(KeyboardInterrupt):
    """SIGTERM: a command ends as on Ctrl-C, in order and with its results written."""


def main(argv: list[str] | None = None) -> int:
    """Run `swiftros ARGV` and return its exit code.

    Returns:
        The command's own, also where the reader of a pipe has left; 2 on bad input or a full disk, 130 when
        interrupted, 143 when terminated.
    """
    if threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGTERM, _terminate)
    use_one_thread(os.environ)
    with output.lasting():
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("once", DamagedRecording)
                warnings.showwarning = functools.partial(_show_warning, warnings.showwarning)
                return run(sys.argv[1:] if argv is None else argv)
        except UsageError as error:
            print(f"swiftros: {error}", file=sys.stderr)
            return 2
        except OSError as error:
            if error.errno not in (errno.ENOSPC, errno.EDQUOT):
                raise
            where = f" for {error.filename}" if error.filename else ""
            print(f"swiftros: the disk has no space left{where}; free some, and repeat the command", file=sys.stderr)
            return 2
        except Terminated:
            return 128 + signal.SIGTERM
        except KeyboardInterrupt:
            return 128 + signal.SIGINT


def _show_warning(others: Callable, message, category, *where) -> None:
    """Print a warning for the user as a sentence; call `others` for one of a library."""
    if issubclass(category, DamagedRecording):
        print(f"swiftros: warning: {message}", file=sys.stderr)
    else:
        others(message, category, *where)


def _terminate(number, frame) -> None:
    signal.signal(signal.SIGTERM, signal.SIG_DFL)  # a second signal ends the process at once
    raise Terminated


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
            raise  # a fault of this repository, not of the installation
        raise UsageError(
            f"'{entry.name}' needs the Python module {error.name}, which is not installed; `make setup` "
            "installs all dependencies"
        ) from error


def find(name, commands):
    """Return the entry point of a command. Raises UsageError for one that is unknown or not installed."""
    if name in commands:
        return commands[name]
    for command in COMMANDS:
        if command.name == name:
            raise UsageError(f"'{name}' belongs to the package {command.package}, which is not installed here")
    raise UsageError(f"there is no command '{name}'; there are {', '.join(commands)}")


def command_table(commands):
    """Return one line for each command: its name and the summary of its module."""
    width = max(map(len, commands), default=0)
    return "commands:\n" + "\n".join(f"  {name:<{width}}  {summary(entry.module)}" for name, entry in commands.items())


def summary(module):
    """Return the first paragraph of a module's docstring without importing the module; "" when there is none."""
    spec = importlib.util.find_spec(module)
    docstring = spec and spec.origin and ast.get_docstring(ast.parse(Path(spec.origin).read_text()))
    return " ".join(docstring.partition("\n\n")[0].split()) if docstring else ""


if __name__ == "__main__":
    sys.exit(main())
