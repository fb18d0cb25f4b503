"""One session of labelling: which frames there are, what is proposed for each, and what a person accepts."""

import threading
import time
from dataclasses import replace

import cv2
import numpy as np

from swift_ros.errors import UsageError
from swift_ros.text import described
from swift_sim_bridge.labelling import clicks
from swift_sim_bridge.labelling.proposals import Proposal, Proposer
from swift_sim_bridge.labels import coco, folder
from swift_sim_bridge.labels.labelled_images import (
    CORNERS,
    NOT_LABELLED,
    OCCLUDED,
    PERSON,
    VISIBLE,
    LabelledGate,
    LabelledImage,
)

MAX_GATES = 100  # in one image: more is damage
MAX_ACTIONS = 2000  # recorded for one image


class Session:
    """Frames with their labels and proposals. Each accepted frame is written at once.

    Args:
        proposer: of the frames.
    """

    def __init__(self, proposer: Proposer):
        self._proposer, self._frames = proposer, proposer.frames
        self._labelled = self._frames.labelled()
        self._proposals: dict[int, list[Proposal]] = {}
        self._lock = threading.RLock()

    def overview(self) -> dict:
        """Return the names of all frames and which are labelled."""
        names = [image.file_name for image in self._frames.images]
        labelled = [name in self._labelled for name in names]
        return {"folder": str(self._frames.path), "names": names, "labelled": labelled, "corners": list(CORNERS)}

    def frame(self, number: int) -> dict:
        """Return what the page shows of a frame: its labels, or proposals."""
        image = self._image(number)
        with self._lock:
            done = self._labelled.get(image.file_name)
            shown = [Proposal(gate, done.source) for gate in done.gates] if done else self._proposed(number)
            if done:
                self._proposals[number] = shown
        gates = [
            {
                "corners": np.nan_to_num(one.gate.corners_px).round(coco.DIGITS).tolist(),
                "visibility": one.gate.visibility.tolist(),
                "origin": one.origin,
            }
            for one in shown
        ]
        return {
            "name": image.file_name,
            "width": image.width,
            "height": image.height,
            "labelled": done is not None,
            "all_gates": done.all_gates if done else True,
            "attitude_known": image.q_world_camera is not None,
            "gates": gates,
        }

    def picture(self, number: int) -> bytes:
        """Return a frame as PNG, in colour where it has any. Raises UsageError when its file is damaged."""
        image = self._image(number)
        found = cv2.imread(str(self._frames.path / image.file_name), cv2.IMREAD_COLOR)
        if found is None:
            raise UsageError(f"{image.file_name} is not a readable image; restore it")
        return cv2.imencode(".png", found, [cv2.IMWRITE_PNG_COMPRESSION, 1])[1].tobytes()

    def accept(self, number: int, sent: dict) -> dict:
        """Write the labels of a frame and record what was done; return the overview.

        Args:
            number: of the frame.
            sent: `gates` with `corners`, `visibility` and `proposal` (its number, or None), `all_gates`, `seconds` and
                `actions` of the person.

        Raises:
            UsageError: a gate is impossible, or a value has a wrong type.
        """
        image = self._image(number)
        gates, used = [], []
        rows = sent.get("gates")
        if not isinstance(rows, list) or len(rows) > MAX_GATES or not isinstance(sent.get("all_gates"), bool):
            raise UsageError(f"{image.file_name}: 'gates' must be a list and 'all_gates' true or false")
        for row in rows:
            gates.append(_gate(row, image))
            used.append(row.get("proposal"))
        seconds, actions = sent.get("seconds"), sent.get("actions")
        if not isinstance(seconds, int | float) or not 0 <= seconds < 1e6 or not isinstance(actions, list):
            raise UsageError(f"{image.file_name}: 'seconds' must be a number and 'actions' a list")
        done = replace(image, gates=tuple(gates), all_gates=sent["all_gates"], source=PERSON)
        coco.check(done, self._frames.path / folder.LABELS)
        with self._lock:
            proposed = [one.gate for one in self._proposals.get(number, ())]
            used = [index if isinstance(index, int) and 0 <= index < len(proposed) else None for index in used]
            labelled = self._labelled | {done.file_name: done}
            coco.write(self._frames.path / folder.LABELS, self._in_order(labelled))
            self._labelled = labelled
            self._proposals.pop(number, None)
            self._forget_tracked(number + 1)
            row = {"image": done.file_name, "time": time.time(), "seconds": seconds}
            row |= {"changes": clicks.changes(proposed, gates, used), "actions": actions[:MAX_ACTIONS]}
            clicks.append(self._frames.path / clicks.CLICKS, row)
        return self.overview()

    def _in_order(self, labelled: dict[str, LabelledImage]) -> list[LabelledImage]:
        """Return labelled images in the order of the frames; those that are no frames first."""
        names = {image.file_name: None for image in self._frames.images}
        others = [image for name, image in labelled.items() if name not in names]
        return others + [labelled[name] for name in names if name in labelled]

    def _image(self, number: int) -> LabelledImage:
        if not 0 <= number < len(self._frames.images):
            raise UsageError(f"there is no frame {number}; there are {len(self._frames.images)}")
        return self._frames.images[number]

    def _proposed(self, number: int) -> list[Proposal]:
        if number not in self._proposals:
            self._proposals[number] = self._proposer.propose(self._image(number), self._before(number))
        return self._proposals[number]

    def _before(self, number: int) -> LabelledImage | None:
        """Return the labelled frame before a frame in its sequence."""
        if number == 0:
            return None
        image, before = self._frames.images[number], self._frames.images[number - 1]
        return self._labelled.get(before.file_name) if image.sequence == before.sequence else None

    def _forget_tracked(self, number: int) -> None:
        """Propose anew for a frame whose predecessor was labelled, which now can be tracked."""
        if number < len(self._frames.images):
            self._proposals.pop(number, None)


def _gate(row, image: LabelledImage) -> LabelledGate:
    """Return the gate that the page sent. Raises UsageError."""
    try:
        corners = np.array(row["corners"], dtype=float).reshape(4, 2)
        visibility = np.array(row["visibility"])
    except (TypeError, ValueError, KeyError) as error:
        raise UsageError(f"{image.file_name}: a gate has no four corners and visibilities") from error
    if visibility.shape != (4,) or not np.isin(visibility, (NOT_LABELLED, OCCLUDED, VISIBLE)).all():
        raise UsageError(f"{image.file_name}: a gate has the visibilities {described(row['visibility'])}")
    visibility = visibility.astype(int)
    return LabelledGate(np.where((visibility == NOT_LABELLED)[:, None], np.nan, corners), visibility)
