"""Run every command of README, CONTRIBUTING and docs in a clean clone; print command, exit code and seconds.

    python scripts/run_documented_commands.py [FOLDER]

The commands are the lines of all bash blocks, in the order of the pages. A comment above a block changes that:

    <!-- not run: REASON -->    the block needs hardware, a GPU, hours, or data that is not in the repository
    <!-- with: COMMAND -->      COMMAND runs in the background meanwhile

Commands that run until Ctrl-C (ENDLESS) get an interrupt after some seconds and must then return 0. A command that
stands on several pages runs once. `make check-docs` runs this script.
"""

import contextlib
import itertools
import os
import re
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import IO

ROOT = Path(__file__).resolve().parent.parent
FIRST_PAGES = ("README.md", "CONTRIBUTING.md")  # then docs/ in alphabetical order
ENDLESS = {
    "swiftros sim": 60.0,
    "swiftros record": 60.0,
}  # s until the interrupt: start-up on a busy machine, and some use
TIMEOUT_S = 1800.0  # of one command; the first `make` also installs everything
READY_TIMEOUT_S = 180.0  # until a command in the background has printed READY
READY = "tcp://"
NOT_RUN, WITH = "not run", "with"


@dataclass(frozen=True)
class Block:
    """One bash block of a page.

    Attributes:
        page: path relative to the repository.
        line: line of the page where the block begins.
        commands: its commands without comments.
        not_run: why it is not run; empty where it is.
        background: command that must run meanwhile; empty for none.
    """

    page: str
    line: int
    commands: tuple[str, ...]
    not_run: str = ""
    background: str = ""


@dataclass(frozen=True)
class Outcome:
    """What came of one command: exit code (None: not run), seconds, and a note."""

    page: str
    command: str
    exit_code: int | None
    seconds: float
    note: str = ""


def main(arguments: list[str]) -> int:
    """Clone, run, print the table. Returns 0 when every command that was run returned 0."""
    folder = Path(arguments[0] if arguments else tempfile.mkdtemp(prefix="swift-documented-")).resolve()
    clone(folder)
    outcomes = []
    for outcome in run_blocks(blocks(folder), folder):
        print(f"-- {outcome.command.splitlines()[0]}: {described(outcome)}", flush=True)
        outcomes.append(outcome)
    failed = [one for one in outcomes if one.exit_code]
    print("\n" + table(outcomes))
    print(f"\n{len(failed)} of {sum(one.exit_code is not None for one in outcomes)} commands failed; clone: {folder}")
    return 1 if failed else 0


def clone(folder: Path) -> None:
    """Clone the repository's last commit into a new or empty folder."""
    if subprocess.run(["git", "status", "--porcelain"], cwd=ROOT, capture_output=True, text=True).stdout:
        print("note: the working tree has changes; the clone has the last commit", flush=True)
    subprocess.run(["git", "clone", "--quiet", "--no-hardlinks", str(ROOT), str(folder)], check=True)


def pages(root: Path) -> list[Path]:
    """Return the pages whose commands are run, in order."""
    return [*(root / name for name in FIRST_PAGES), *sorted((root / "docs").rglob("*.md"))]


def blocks(root: Path) -> list[Block]:
    """Return the bash blocks of all pages."""
    return [block for page in pages(root) for block in blocks_of(page.relative_to(root).as_posix(), page.read_text())]


def blocks_of(page: str, text: str) -> Iterator[Block]:
    """Yield the bash blocks of a page with their markers."""
    pattern = r"(?ms)^(?:<!-- (?P<marker>not run|with): (?P<value>.*?) -->\n)?^```bash\n(?P<body>.*?)^```$"
    for found in re.finditer(pattern, text):
        markers = {found["marker"]: found["value"]} if found["marker"] else {}
        commands = tuple(commands_of(found["body"].replace("\\\n", " ")))
        line = text.count("\n", 0, found.start("body")) + 1
        yield Block(page, line, commands, markers.get(NOT_RUN, ""), markers.get(WITH, ""))


def commands_of(body: str) -> Iterator[str]:
    """Yield the commands of a block: a line each, a here-document with its lines."""
    lines = iter(body.splitlines())
    for line in lines:
        if here := re.search(r"<<'(\w+)'$", line):
            inside = itertools.takewhile(lambda inner, end=here[1]: inner != end, lines)
            yield "\n".join([line, *inside, here[1]])
        elif command := without_comment(line):
            yield command


def without_comment(line: str) -> str:
    """Return a command line without the comment at its end."""
    return re.sub(r"(^|\s+)#.*", "", line).strip()


def run_blocks(found: list[Block], folder: Path) -> Iterator[Outcome]:
    """Run the blocks in order and yield the outcome of each command."""
    known: dict[str, int] = {}
    for block in found:
        if block.not_run:
            yield from (Outcome(block.page, command, None, 0.0, block.not_run) for command in block.commands)
            continue
        due = [command for command in block.commands if command not in known]
        yield from (Outcome(block.page, one, None, 0.0, "run above") for one in block.commands if one in known)
        background, domain = start_background(block.background, folder) if block.background and due else (None, {})
        if background and background.poll() is not None:
            yield Outcome(block.page, block.background, background.returncode or 1, 0.0)
            yield from (Outcome(block.page, one, None, 0.0, f"needs {block.background}") for one in due)
            continue
        for command in due:
            begin = time.monotonic()
            known[command] = run_command(command, folder, domain)
            yield Outcome(block.page, command, known[command], time.monotonic() - begin)
        if background:
            code = interrupted(background)
            yield Outcome(block.page, block.background, code, 0.0, "in the background")


def run_command(command: str, folder: Path, variables: dict[str, str] | None = None) -> int:
    """Run one command in the clone with its environment active, and return its exit code."""
    process = started(command, folder, variables)
    seconds = next((seconds for name, seconds in ENDLESS.items() if command.startswith(name)), None)
    try:
        return process.wait(TIMEOUT_S if seconds is None else seconds)
    except subprocess.TimeoutExpired:
        return interrupted(process) if seconds is not None else ended(process)


def started(
    command: str, folder: Path, variables: dict[str, str] | None = None, output: IO | None = None
) -> subprocess.Popen:
    """Start a command in a session of its own, its input open and silent.

    Args:
        command: a line of a page.
        folder: the clone.
        variables: variables of the environment beside those of a new terminal.
        output: file for what it prints; None: the terminal.
    """
    activate = ". .venv/bin/activate; " if (folder / ".venv/bin/activate").exists() else ""
    return subprocess.Popen(
        ["bash", "-c", f"{activate}exec {command}" if is_simple(command) else f"{activate}{command}"],
        cwd=folder,
        env=environment() | (variables or {}),
        stdin=subprocess.PIPE,
        stdout=output,
        stderr=subprocess.STDOUT if output else None,
        start_new_session=True,
        preexec_fn=accept_interrupts,
    )


def accept_interrupts() -> None:
    """Let Ctrl-C end this process also where its parent, such as a shell's background job, ignores it."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


def is_simple(command: str) -> bool:
    """Return whether a command is one program, so that signals go to it and not to its shell."""
    return command.startswith("swiftros ")


def start_background(command: str, folder: Path) -> tuple[subprocess.Popen, dict[str, str]]:
    """Start a command and wait until it has printed READY, or has ended because it did not.

    Returns:
        its process, and the variables by which other commands find its ROS domain.
    """
    with tempfile.NamedTemporaryFile("w+", prefix="swift-background-") as output:
        process = started(command, folder, output=output)
        deadline = time.monotonic() + READY_TIMEOUT_S
        while time.monotonic() < deadline and process.poll() is None:
            text = Path(output.name).read_text()
            if READY in text:
                domain = re.search(r"ROS domain:? (\d+)", text)
                return process, {"ROS_DOMAIN_ID": domain[1]} if domain else {}
            time.sleep(0.5)
        ended(process)
        print(f"`{command}` did not get ready; it printed\n{Path(output.name).read_text()}", flush=True)
        return process, {}


def interrupted(process: subprocess.Popen) -> int:
    """Send what Ctrl-C sends, and return the exit code."""
    with contextlib.suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGINT)
    try:
        return process.wait(60.0)
    except subprocess.TimeoutExpired:
        return ended(process)


def ended(process: subprocess.Popen) -> int:
    """Kill the process and its children, if any are left, and return the exit code."""
    with contextlib.suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)
    return process.wait()


def environment() -> dict[str, str]:
    """Return the environment of a new terminal: without the virtual environment and the ROS paths of this process."""
    hidden = ["VIRTUAL_ENV", "PYTHONPATH", "LD_LIBRARY_PATH", "AMENT_PREFIX_PATH", "CMAKE_PREFIX_PATH"]
    hidden += ["MAKEFLAGS", "MAKELEVEL", "ARGS"]  # of the `make check-docs ARGS=FOLDER` that started this process
    kept = {name: value for name, value in os.environ.items() if name not in hidden and not name.startswith("_ROS")}
    path = [part for part in kept.get("PATH", os.defpath).split(os.pathsep) if not part.startswith(str(ROOT))]
    return kept | {"PATH": os.pathsep.join(path)}


def described(outcome: Outcome) -> str:
    """Return the exit code and time of an outcome, or why the command was not run."""
    if outcome.exit_code is None:
        return outcome.note
    return f"exit code {outcome.exit_code}, {outcome.seconds:.0f} s"


def table(outcomes: list[Outcome]) -> str:
    """Return the outcomes as aligned lines: page, command, exit code, seconds or note."""
    rows = [("page", "command", "exit", "seconds")]
    for one in outcomes:
        ran = one.exit_code is not None
        rows.append(
            (
                one.page,
                one.command.splitlines()[0],
                str(one.exit_code) if ran else "-",
                f"{one.seconds:.0f}" if ran else one.note,
            )
        )
    widths = [max(len(row[i]) for row in rows) for i in range(3)]
    return "\n".join(
        "  ".join([*(cell.ljust(width) for cell, width in zip(row, widths, strict=False)), row[3]]) for row in rows
    )


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
