"""A hundred images of a race are labelled on the page within ten minutes of a modelled person's time."""

import threading

import numpy as np
import pytest
from labelling_person import Work, correct, opened_page

from swift_ros import cli
from swift_sim_bridge.gate_detector.evaluation.setup import load_setup
from swift_sim_bridge.labelling import clicks, frames
from swift_sim_bridge.labelling.proposals import Proposer, is_same
from swift_sim_bridge.labelling.server import LabellingServer
from swift_sim_bridge.labelling.session import Session

IMAGES, EVERY = 100, 8
PERSON_S = 600.0  # s, for all images
LEAST_SIDE_PX = 9.0  # of a gate that the person labels, as in the scores of the detector


@pytest.fixture(scope="module")
def bag(tmp_path_factory):
    """Return the bag of a race."""
    out = tmp_path_factory.mktemp("race")
    assert cli.main(["race", "--seed", "0", "--out", str(out)]) == 0
    return out / "seed-0" / "bag"


@pytest.mark.parametrize("poses", ["state/odometry", frames.WITHOUT_MAP])
def test_a_hundred_images_take_less_than_ten_minutes(bag, repository, tmp_path, capsys, poses):
    setup = load_setup(repository / "config")
    truth = Proposer(frames.of_bag(bag, tmp_path / "truth", frames.BagFrames(every=EVERY)), setup)
    found = frames.of_bag(bag, tmp_path / "labels", frames.BagFrames(every=EVERY, poses=poses))
    images = truth.frames.images[:IMAGES]
    true_gates = {
        image.file_name: [gate for gate in truth.from_map(image)[0] if gate.side_px >= LEAST_SIDE_PX]
        for image in images
    }
    server = LabellingServer(Session(Proposer(found, setup)), 0)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    work = Work()
    with opened_page(server.address) as page:
        for number, image in enumerate(images):
            page.wait_for_selector(f"body[data-frame='{number}']")
            correct(page, true_gates[image.file_name], work)
    server.shutdown()
    server.server_close()
    with capsys.disabled():
        print(f"\n{poses}: {clicks.summary(found.path / clicks.CLICKS)}; modelled time {work.seconds:.0f} s")
    assert work.seconds < PERSON_S
    labelled = found.labelled()
    assert len(labelled) == len(images)
    for image in images:
        for gate in true_gates[image.file_name]:
            if gate.is_whole:
                same = [one for one in labelled[image.file_name].gates if is_same(one, gate)]
                assert same and np.nanmax(np.linalg.norm(same[0].corners_px - gate.corners_px, axis=-1)) < 2.5
