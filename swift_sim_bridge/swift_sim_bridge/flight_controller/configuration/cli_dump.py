"""CLI dumps: the configuration of a flight controller as Betaflight's `diff all` or `dump all` prints it."""

import re
from dataclasses import dataclass
from pathlib import Path

from swift_ros.errors import UsageError
from swift_sim_bridge.flight_controller.configuration import cli_settings

FIRMWARE = "4.5"  # the simulated version
SETTING = re.compile(r"set\s+(\w+)\s*=\s*(.*)", re.IGNORECASE)
# Commands for boards, wiring, receivers and LEDs, which do not affect motor commands.
IGNORED_COMMANDS = frozenset(
    {
        "batch",
        "defaults",
        "board_name",
        "manufacturer_id",
        "mcu_id",
        "signature",
        "resource",
        "timer",
        "dma",
        "serial",
        "map",
        "servo",
        "smix",
        "beeper",
        "beacon",
        "led",
        "color",
        "mode_color",
        "vtx",
        "vtxtable",
        "rxrange",
        "rxfail",
        "save",
        "name",
        "display_name",
        "simplified_tuning",
        "exit",
    }
)


@dataclass(frozen=True)
class Dump:
    """The content of a CLI dump.

    Attributes:
        settings: every simulated setting of the active profiles, as numbers and names.
        features: features that are switched on.
        unmodelled: functions that the dump switches on and that are not simulated, one phrase each.
    """

    settings: dict
    features: frozenset[str]
    unmodelled: tuple[str, ...]


def read(path: Path) -> Dump:
    """Read a dump. Raises UsageError when the file cannot be read, is no dump, or has an invalid value."""
    try:
        text = path.read_text(errors="replace")
    except OSError as error:
        raise UsageError(f"{path} cannot be read: {error.strerror}; save Betaflight's `diff all` there") from error
    return parse(text, str(path))


def parse(text: str, where: str) -> Dump:
    """Parse the text of a dump; `where` names it in errors. Raises UsageError as `read`."""
    reader = _Reader(where)
    for number, line in enumerate(text.splitlines(), start=1):
        reader.take(line.strip(), number)
    if not reader.settings_seen:
        raise UsageError(f"{where} contains no settings; give the text that Betaflight's CLI prints for `diff all`")
    return reader.result()


class _Reader:
    """Reads lines in their order; `profile` and `rateprofile` select the profile of the settings after them."""

    def __init__(self, where: str):
        self._where = where
        self._profile = {"profile": 0, "rateprofile": 0}
        self._values: dict = {}
        self._others: dict[str, str] = {}
        self._features = set(cli_settings.DEFAULT_FEATURES)
        self._remarks: list[str] = []
        self.settings_seen = 0

    def take(self, line: str, number: int) -> None:
        """Read a line with its number."""
        if line.startswith("#"):
            self._note_version(line)
        elif match := SETTING.fullmatch(line):
            self.settings_seen += 1
            self._set(match[1].lower(), match[2].strip(), number)
        elif line:
            self._run_command(line.split(), number)

    def _note_version(self, line: str) -> None:
        version = re.match(r"#\s*Betaflight\s*/.*?\s(\d+\.\d+)\.\d+\s", line)
        if version and version[1] != FIRMWARE:
            self._remarks.append(f"firmware {version[1]}: the simulated one is {FIRMWARE}")

    def _set(self, name: str, text: str, number: int) -> None:
        where = f"{self._where}, line {number}"
        if name in cli_settings.MASTER:
            self._values[name] = cli_settings.value_of(name, text, where)
        elif name in cli_settings.PID_PROFILE:
            self._values["profile", self._profile["profile"], name] = cli_settings.value_of(name, text, where)
        elif name in cli_settings.RATE_PROFILE:
            self._values["rateprofile", self._profile["rateprofile"], name] = cli_settings.value_of(name, text, where)
        elif name in cli_settings.UNMODELLED:
            self._others[name] = text.upper()
        elif not name.startswith(cli_settings.IGNORED_PREFIXES):
            self._remarks.append(f"line {number}: the unknown setting {name} = {text}")

    def _run_command(self, words: list[str], number: int) -> None:
        command, rest = words[0].lower(), words[1:]
        if command in self._profile:
            if not (rest and rest[0].isdigit()):
                raise UsageError(f"{self._where}, line {number}: '{' '.join(words)}' lacks the number of the profile")
            self._profile[command] = int(rest[0])
        elif command == "feature" and rest:
            name = rest[0].upper()
            (self._features.discard if name.startswith("-") else self._features.add)(name.lstrip("-"))
        elif command == "mixer" and rest[:1] == ["QUADX"] or command in IGNORED_COMMANDS or rest[:1] == ["reset"]:
            return
        elif command == "aux":
            self._note_switch(rest, number)
        elif command in ("mixer", "mmix", "adjrange"):
            self._remarks.append(f"line {number}: {' '.join(words)}")
        else:
            self._remarks.append(f"line {number}: the unknown '{' '.join(words)}'")

    def _note_switch(self, words: list[str], number: int) -> None:
        """Note a mode switch: slot, mode, AUX channel, range; an empty range is no switch."""
        if len(words) < 5 or not all(word.lstrip("-").isdigit() for word in words):
            raise UsageError(f"{self._where}, line {number}: 'aux {' '.join(words)}' is not a mode switch")
        mode, low_us, high_us = (int(words[i]) for i in (1, 3, 4))
        if low_us < high_us and mode in cli_settings.UNMODELLED_MODES:
            self._remarks.append(f"mode {cli_settings.UNMODELLED_MODES[mode]} on a switch")

    def result(self) -> Dump:
        """Return the dump with the settings of the active profiles."""
        settings = cli_settings.all_defaults()
        for key, value in self._values.items():
            if isinstance(key, str):
                settings[key] = value
            elif key[1] == self._profile[key[0]]:
                settings[key[2]] = value
        remarks = [*self._remarks, *self._unmodelled(settings)]
        remarks += [f"feature {name}" for name in sorted(self._features & cli_settings.UNMODELLED_FEATURES)]
        return Dump(settings, frozenset(self._features), tuple(remarks))

    def _unmodelled(self, settings: dict):
        for name, setting in cli_settings.UNMODELLED.items():
            value = self._others.get(name, setting.default)
            if value not in setting.off:
                yield f"{name} = {value}" + ("" if name in self._others else " (the firmware's default)")
        if settings["mixer_type"] == "EZLANDING":
            yield "mixer_type = EZLANDING"
