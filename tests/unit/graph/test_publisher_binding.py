"""A subscription keeps to the publisher that it began with, whatever the numbers of others."""

import numpy as np
import pytest

from swift_ros.graph.publisher_binding import Arrival, Origin, PublisherBinding

PERIOD_S = 0.01


def flown(binding, others, *, own_begin=400, count=300, lost=()):
    """Return the messages that a binding takes of its own publisher and of others.

    Args:
        binding: under test.
        others: (begin tick, first number, messages per tick) of each further publisher.
        own_begin: number of the own publisher's first message.
        count: ticks.
        lost: ticks whose own message is lost.
    """
    taken = []
    for tick in range(count):
        time_s = tick * PERIOD_S
        sent = [("own", own_begin + tick)] * (tick not in lost)
        for name, (begin, first, rate) in enumerate(others):
            sent += [(name, first + (tick - begin) * rate + k) for k in range(rate) if tick >= begin]
        for k, (sender, sequence) in enumerate(sent):
            at_s = time_s + k * PERIOD_S / 40
            arrival = Arrival(sequence, at_s, at_s)
            origin = binding.origin(arrival)
            # a subscription that is unsure decides by the message's stamp, which only the own publisher sets
            if origin is Origin.OWN or origin is Origin.UNSURE and sender == "own":
                binding.accept(arrival)
                taken.append(sender)
            else:
                binding.refuse(arrival)
    return taken


@pytest.mark.parametrize("first", [1, 2, 17])
@pytest.mark.parametrize("rate", [1, 2, 5, 20])
def test_a_publisher_that_comes_later_is_refused_even_while_its_numbers_overtake_the_own_ones(first, rate):
    taken = flown(PublisherBinding(is_event=False), [(20, first, rate)])
    assert taken == ["own"] * 300


def sent(rng, period_s, begin_s, first_number, end_s, jitter):
    """Return (time of sending, number) of a publisher with irregular periods."""
    count = int((end_s - begin_s) / period_s)
    times = begin_s + period_s * (np.arange(count) + jitter * rng.standard_normal(count))
    return [(time_s, first_number + k) for k, time_s in enumerate(np.maximum.accumulate(times))]


@pytest.mark.parametrize("jitter", [0.02, 0.1, 0.3])
@pytest.mark.parametrize("seed", range(40))
def test_one_whose_stamps_are_valid_too_is_found_out_by_its_period(seed, jitter):
    """Its numbers reach the own ones between two messages: only the times differ, and they may err for a moment."""
    rng = np.random.default_rng([seed, round(100 * jitter)])
    period_s, ratio = 10 ** rng.uniform(-2, -1), 10 ** rng.uniform(0.06, 1.3)
    begin_s = period_s * rng.uniform(100, 400)
    end_s = begin_s * ratio / (ratio - 1) + 200 * period_s
    own = [(*row, "own") for row in sent(rng, period_s, 0.0, 1, end_s, jitter)]
    other = [(*row, "other") for row in sent(rng, period_s / ratio, begin_s, 1, end_s, jitter)]
    binding, taken = PublisherBinding(is_event=False), []
    for time_s, number, sender in sorted(own + other):
        arrival = Arrival(number, time_s, time_s)
        if binding.origin(arrival) in (Origin.OWN, Origin.UNSURE):
            binding.accept(arrival)
            taken.append((time_s, sender))
        else:
            binding.refuse(arrival)
    wrong_s = [time_s for time_s, sender in taken if sender == "other"]
    assert not wrong_s or wrong_s[-1] - wrong_s[0] < 61 * period_s
    assert {sender for _, sender in taken[-50:]} == {"own"}


def test_two_further_publishers_at_once_are_refused():
    taken = flown(PublisherBinding(is_event=False), [(5, 1, 3), (60, 1, 4)])
    assert taken == ["own"] * 300


def test_lost_messages_are_no_reason_to_refuse_the_next():
    taken = flown(PublisherBinding(is_event=False), [], lost=(3, 4, 5, 50, 52, 54, *range(100, 180)))
    assert taken == ["own"] * (300 - 86)


def test_messages_that_a_full_queue_has_lost_are_no_reason_to_refuse_the_next():
    binding = PublisherBinding(is_event=False)
    binding.accept(Arrival(7, 1.00, 5.0))
    # two that are received at once, after a pause of the subscriber, with four in between that were lost
    assert binding.origin(Arrival(12, 1.05, 5.0001)) is Origin.OWN
    assert binding.origin(Arrival(12, 1.00, 5.0001)) is Origin.AHEAD


def test_an_event_is_never_sure_and_one_out_of_turn_is_of_another_publisher():
    binding = PublisherBinding(is_event=True)
    assert binding.origin(Arrival(7, 0.0, 0.0)) is Origin.OWN
    binding.accept(Arrival(7, 0.0, 0.0))
    assert binding.origin(Arrival(8, 60.0, 60.0)) is Origin.UNSURE
    assert binding.origin(Arrival(9, 60.0, 60.0)) is Origin.AHEAD
    assert binding.origin(Arrival(1, 60.0, 60.0)) is Origin.BEHIND


def test_a_publisher_that_took_the_place_of_another_one_is_followed_by_its_own_numbers_and_times():
    binding = PublisherBinding(is_event=False)
    for number in range(500, 600):
        binding.accept(Arrival(number, 0.01 * number, 0.01 * number))
    taken = flown(binding, [(20, 1, 2)], own_begin=1)
    assert taken == [] and binding.may_change(10.0)
    binding.accept(Arrival(1, 10.0, 10.0))
    assert binding.origin(Arrival(2, 10.01, 10.01)) is not Origin.BEHIND
    assert binding.origin(Arrival(600, 10.01, 10.01)) is Origin.AHEAD


def test_an_event_that_comes_when_another_publisher_is_due_is_of_that_one():
    binding = PublisherBinding(is_event=True)
    for number in range(1, 5):
        binding.accept(Arrival(number, 1.0 * number, 1.0 * number))
    for number in range(1, 40):
        time_s = 5.0 + 0.05 * number
        assert binding.origin(Arrival(number, time_s, time_s)) in (Origin.BEHIND, Origin.AHEAD)
        binding.refuse(Arrival(number, time_s, time_s))
    assert binding.origin(Arrival(5, 8.0, 8.0)) is Origin.UNSURE  # the own next one


def test_another_publisher_may_follow_only_when_the_own_one_has_been_silent_for_long():
    binding = PublisherBinding(is_event=False)
    assert not binding.may_change(100.0)
    binding.accept(Arrival(7, 0.0, 100.0))
    assert not binding.may_change(100.5) and binding.may_change(101.1)
