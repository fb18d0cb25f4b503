"""Each run has a ROS domain of its own."""

import subprocess
import sys

import pytest

from swift_ros.errors import UsageError
from swift_ros.graph.domain import RunDomain, free_domain


def test_two_runs_on_one_machine_use_different_domains(monkeypatch):
    monkeypatch.delenv("ROS_DOMAIN_ID", raising=False)
    (first, held), (second, also_held) = free_domain(), free_domain()
    assert first != second and 1 <= first <= 101 and 1 <= second <= 101
    held.close()
    also_held.close()
    monkeypatch.setenv("ROS_DOMAIN_ID", "7")
    assert free_domain() == (7, None)
    monkeypatch.setenv("ROS_DOMAIN_ID", "300")
    with pytest.raises(UsageError, match="300"):
        free_domain()


def test_a_second_run_in_a_chosen_domain_is_refused_until_the_first_has_ended(monkeypatch):
    monkeypatch.delenv("ROS_DOMAIN_ID")
    number, reservation = free_domain()  # as tests do for the runs that they start
    monkeypatch.setenv("ROS_DOMAIN_ID", str(number))
    first = RunDomain()
    with pytest.raises(UsageError, match=f"another run of swiftros uses ROS domain {number}; unset ROS_DOMAIN_ID"):
        RunDomain()
    reservation.close()
    monkeypatch.delenv("ROS_DOMAIN_ID")
    other = RunDomain()
    assert other.number != number  # a run in a chosen domain has no reservation
    other.close()
    first.close()
    monkeypatch.setenv("ROS_DOMAIN_ID", str(number))
    RunDomain().close()


def test_a_run_stays_out_of_the_domain_of_a_launch_file_until_that_ends(monkeypatch):
    monkeypatch.delenv("ROS_DOMAIN_ID")
    number, reservation = free_domain()
    reservation.close()
    story = f"from swift_ros.graph.domain import mark_domain; mark_domain({number}); print(); input()"
    launched = subprocess.Popen([sys.executable, "-c", story], stdin=subprocess.PIPE, stdout=subprocess.PIPE)
    launched.stdout.readline()
    run = RunDomain()
    assert run.number != number
    run.close()
    monkeypatch.setenv("ROS_DOMAIN_ID", str(number))
    with pytest.raises(UsageError, match=f"uses ROS domain {number}"):
        RunDomain()
    launched.communicate(b"\n")
    RunDomain().close()
