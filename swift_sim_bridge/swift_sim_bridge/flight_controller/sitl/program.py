"""The user's Betaflight SITL binary as a child process with its own folder; it ends with this process."""

import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

from swift_ros.errors import UsageError
from swift_ros.working_time import WorkingTime
from swift_sim_bridge.flight_controller.sitl import pass_clock

END_S = 5.0  # working time: longest time until the program ends after `save`
POLL_S = 0.01  # between two looks whether it has ended
OUTPUT_HOST = "127.0.0.1"  # receives the motor outputs
LAUNCHER = Path(__file__).with_name("launch.py")


class Program:
    """A Betaflight SITL program.

    Attributes:
        binary: path of the program.
    """

    def __init__(self, binary, folder, counted: bool = False):
        """Find the program.

        Args:
            binary: path or name of the program.
            folder: folder for its settings (eeprom.bin) and log; it is created.
            counted: whether its clock counts passes of the rate loop (see `pass_clock`).

        Raises:
            UsageError: there is no such program.
        """
        self.binary, self._folder = executable(binary), Path(folder)
        self._folder.mkdir(parents=True, exist_ok=True)
        self._environment = ["/usr/bin/env", f"LD_PRELOAD={pass_clock.compiled(self._folder)}"] if counted else []
        self._process: subprocess.Popen | None = None

    @property
    def log(self) -> Path:
        """File with the program's output."""
        return self._folder / "sitl.log"

    def start(self) -> None:
        """Start the program."""
        launcher = [sys.executable, "-I", "-S", str(LAUNCHER), str(os.getpid())]
        with open(self.log, "ab") as log:
            self._process = subprocess.Popen(
                [*launcher, *self._environment, str(self.binary), OUTPUT_HOST],
                cwd=self._folder,
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=subprocess.STDOUT,
                start_new_session=True,
            )

    def inherit_priority(self) -> None:
        """Give its threads the scheduling policy and priority of the calling thread."""
        policy, parameters = os.sched_getscheduler(0), os.sched_getparam(0)
        for thread in os.listdir(f"/proc/{self._process.pid}/task"):
            os.sched_setscheduler(int(thread), policy, parameters)

    def runs(self) -> bool:
        """Return whether the program runs."""
        return self._process.poll() is None

    def check(self) -> None:
        """Raise UsageError when the program has ended."""
        code = self._process.poll()
        if code is not None:
            how = f"was killed by {signal.Signals(-code).name}" if code < 0 else f"exited with {code}"
            raise UsageError(f"Betaflight SITL {how}; see {self.log}")

    def await_end(self) -> None:
        """Wait until the program has ended. Raises UsageError when it does not end within END_S."""
        clock = WorkingTime()
        while self.runs():
            if clock.now_s() > END_S:
                raise UsageError(f"Betaflight SITL does not end to restart with its settings; see {self.log}")
            time.sleep(POLL_S)

    def end(self) -> None:
        """Kill the program; it has nothing to save and handles no other signal."""
        if self._process is not None:
            self._process.kill()
            self._process.wait()


def executable(binary) -> Path:
    """Return the absolute path of a program, given by path or name. Raises UsageError when it cannot be run."""
    path = Path(shutil.which(str(binary)) or binary).resolve()
    if not path.is_file():
        raise UsageError(
            f"there is no Betaflight SITL binary {binary}; get one (docs/simulation/sitl.md) and give its path"
        )
    if not os.access(path, os.X_OK):
        raise UsageError(f"{binary} is not executable; give the path of a Betaflight SITL binary")
    return path
