"""The user's own Betaflight SITL binary as a child process, in a folder of its own, that ends with this process."""

import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path

from swift_ros.errors import UsageError
from swift_sim_bridge.flight_controller.sitl import pass_clock

END_S = 5.0
OUTPUT_HOST = "127.0.0.1"  # where it sends motor outputs
LAUNCHER = Path(__file__).with_name("launch.py")


class Program:
    """binary: path or name of the program; folder: where it keeps its settings (eeprom.bin) and `log`; counted: whether
    its clock counts passes (see `pass_clock`).

    Raises UsageError when there is no such program.
    """

    def __init__(self, binary, folder, counted: bool = False):
        self.binary, self._folder = executable(binary), Path(folder)
        self._folder.mkdir(parents=True, exist_ok=True)
        self._before = ["/usr/bin/env", f"LD_PRELOAD={pass_clock.compiled(self._folder)}"] if counted else []
        self._process: subprocess.Popen | None = None

    @property
    def log(self) -> Path:
        """What the program prints."""
        return self._folder / "sitl.log"

    def start(self) -> None:
        """Start the program."""
        launcher = [sys.executable, "-I", "-S", str(LAUNCHER), str(os.getpid())]
        with open(self.log, "ab") as log:
            self._process = subprocess.Popen(
                [*launcher, *self._before, str(self.binary), OUTPUT_HOST],
                cwd=self._folder,
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=subprocess.STDOUT,
                start_new_session=True,
            )

    def inherit_priority(self) -> None:
        """Give its threads the scheduling of the calling one."""
        policy, parameters = os.sched_getscheduler(0), os.sched_getparam(0)
        for thread in os.listdir(f"/proc/{self._process.pid}/task"):
            os.sched_setscheduler(int(thread), policy, parameters)

    def runs(self) -> bool:
        """Return whether the program has not ended."""
        return self._process.poll() is None

    def check(self) -> None:
        """Raise UsageError when the program has ended."""
        code = self._process.poll()
        if code is not None:
            how = f"was killed by {signal.Signals(-code).name}" if code < 0 else f"exited with {code}"
            raise UsageError(f"Betaflight SITL {how}; see {self.log}")

    def await_end(self) -> None:
        """Wait until the program has ended by itself. Raises UsageError when it does not."""
        try:
            self._process.wait(END_S)
        except subprocess.TimeoutExpired:
            raise UsageError(f"Betaflight SITL does not end to restart with its settings; see {self.log}") from None

    def end(self) -> None:
        """Kill it: it has nothing to save, and no handler for anything gentler."""
        if self._process is not None:
            self._process.kill()
            self._process.wait()


def executable(binary) -> Path:
    """Return the whole path of a program by its path or name. Raises UsageError when it cannot be run."""
    path = Path(shutil.which(str(binary)) or binary).resolve()
    if not path.is_file():
        raise UsageError(f"there is no Betaflight SITL binary {binary}; get one (README) and give its path")
    if not os.access(path, os.X_OK):
        raise UsageError(f"{binary} is not executable; give the path of a Betaflight SITL binary")
    return path
