"""Latencies: simulate a graph with known delays and recover each hop and both chains."""

import pytest

from swift_ros.graph.latency import FRAME, Publications, table, written_ns

MS = 1_000_000


def graph(ticks=300, detector_ms=24.0):
    """Return the hops of a graph with odometry every 10 ms, an image every 30 ms and known delays."""
    publications, updates = Publications(), []
    for tick in range(ticks):
        stamp = tick * 10 * MS
        if tick % 3 == 0:
            publications.record("camera/image_raw", stamp, stamp)
            publications.record("gates/detections", stamp, stamp + round(detector_ms * MS))
            publications.record("gates/poses", stamp, stamp + round((detector_ms + 1) * MS))
            publications.record("state/updates", stamp, stamp + round((detector_ms + 2) * MS))
            updates.append(stamp)
        for topic, delay in (
            ("vio/raw", 0),
            ("vio/odometry", 0.5),
            ("state/odometry", 1.0),
            ("policy/step", 1.5),
            ("command/body_rate_thrust", 1.5),
            ("betaflight/link", 2.0),
        ):
            publications.record(topic, stamp, stamp + round(delay * MS))
    return publications.hops()


def test_each_hop_and_both_chains_are_measured():
    hops = graph()
    assert hops["vio/raw to vio/odometry"] == pytest.approx(0.5)
    assert hops["command/body_rate_thrust to betaflight/link"] == pytest.approx(0.5)
    assert hops[f"odometry to {FRAME}"] == pytest.approx(2.0)
    assert hops["camera/image_raw to gates/detections"] == pytest.approx(24.0)
    # the update at 26 ms is first used by the state of 30 ms, published at 31 ms; its frame is written at 32 ms
    assert hops["state/updates to state/odometry"] == pytest.approx(5.0)
    assert hops[f"image to {FRAME}"] == pytest.approx(32.0)


def test_a_slower_detector_delays_the_frame_by_a_whole_step_of_odometry():
    assert graph(detector_ms=29.5)[f"image to {FRAME}"] == pytest.approx(42.0)


def test_a_graph_without_its_raw_odometry_or_images_still_has_its_other_hops():
    publications = Publications()
    for topic, at in (("vio/odometry", 0), ("state/odometry", 1), ("betaflight/link", 3)):
        publications.record(topic, 0, at * MS)
    hops = publications.hops()
    assert hops[f"odometry to {FRAME}"] == pytest.approx([3.0])
    assert len(hops[f"image to {FRAME}"]) == 0
    assert "vio/odometry to state/odometry" in table(hops)


def test_the_write_time_is_the_header_stamp_unless_it_is_on_simulated_time():
    now = 1_700_000_000 * 10**9
    assert written_ns(now - MS, now) == now - MS
    assert written_ns(12 * MS, now) == now
