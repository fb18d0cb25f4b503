"""Settings of the link: section `betaflight` of nodes.yaml."""

import termios
from dataclasses import dataclass
from urllib.parse import urlsplit

from swift_ros.configuration import refuse_outside, setting
from swift_ros.text import described

RECEIVERS = ("msp", "msp_override")


def tcp_address(port: str) -> tuple[str, int] | None:
    """Return host and port of tcp://HOST:PORT; None for the path of a device. Raises ValueError for anything else."""
    if port and "://" not in port:
        return None
    try:
        address = urlsplit(port)
        host, number = address.hostname, address.port
    except ValueError as error:
        raise ValueError(
            f"the port {described(port)} is no address; give tcp://HOST:PORT, with a port from 1 to 65535"
        ) from error
    if address.scheme != "tcp" or not host or not number:
        raise ValueError(f"the port {described(port)} is neither tcp://HOST:PORT nor a serial device")
    return host, number


def serial_speed(baud: int) -> int:
    """Return the system's constant of a speed in bits/s. Raises ValueError for one that serial devices lack."""
    speed = getattr(termios, f"B{baud}", None)
    if speed is None:
        raise ValueError(
            f"{described(baud)} bits/s is not a serial speed of this system; set `baud` to 115200 or 921600"
        )
    return speed


@dataclass(frozen=True)
class LinkSettings:
    """Section `betaflight` of nodes.yaml."""

    port: str = setting("tcp://HOST:PORT, or the path of a serial device or pseudo-terminal")
    baud: int = setting("bits/s of a serial device; USB ignores it", 9600, 4_000_000)
    connect_timeout_s: float = setting("s to keep trying to connect", 0, 600)
    receiver: str = setting("msp: this node arms the vehicle; msp_override: the pilot's radio does")
    state_required: bool = setting("false: manual flight without state/odometry and race/judged; faults stop motors")
    silence_s: float = setting("s without a valid command or state until the failsafe", 0.02, 1)
    stale_s: float = setting("s; a command or state with an older stamp is ignored", 0.02, 5)
    judge_silence_s: float = setting("s without a message of the race monitor until the failsafe", 0.02, 5)
    lockstep_silence_s: float = setting("lockstep: these limits in working time; above patience_s of the bridge", 5, 60)
    failsafe_level_tilt_deg: float = setting("degrees of tilt below which the throttle opens again", 5, 90)
    failsafe_descent_s: float = setting("without a state: s from the begin of sinking to zero thrust", 0.1, 10)
    firmware_failsafe_s: float = setting("s; refuse to arm when the firmware's own failsafe takes longer", 0.1, 30)
    level_limit_deg: float = setting("degrees; refuse to arm when tilted more", 1, 45)
    min_cell_v: float = setting("V per cell, not of the pack; refuse to arm below", 0, 4.4)
    assumed_voltage: float = setting("V of the pack where nothing measures it (bench, SITL); 0: measured", 0, 100)
    voltmeter_s: float = setting("s, time constant of the firmware's voltmeter (vbat_display_lpf_period)", 0, 10)
    status_ticks: int = setting("frames between two requests of status and attitude", 1, 1000)
    battery_ticks: int = setting("frames between two requests of the battery", 1, 1000)
    rotor_ticks: int = setting("frames between two requests of the rotors", 1, 1000)

    def __post_init__(self):
        refuse_outside(RECEIVERS, receiver=self.receiver)
        if tcp_address(self.port) is None:
            serial_speed(self.baud)
        if self.stale_s < self.silence_s:
            raise ValueError(
                f"'stale_s' {self.stale_s:g} s is below 'silence_s' {self.silence_s:g} s: messages that are in time "
                "would be ignored; give a larger one"
            )
