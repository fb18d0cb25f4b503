"""The pilot's network in ONNX Runtime: 31 inputs, 4 outputs."""

from pathlib import Path

import numpy as np
import onnxruntime

from swift_ros.errors import UsageError
from swift_ros.policy.observation import SIZE as OBSERVATION_SIZE
from swift_ros.text import excerpt

ACTION_SIZE = 4  # thrust and three body rates


class Actor:
    """One model on one CPU thread; it is too small for an accelerator.

    Args:
        path: ONNX file.

    Raises:
        UsageError: the file is missing, is not an ONNX model, has not [1, 31] float32 as input and [1, 4] as output, or
            cannot be run.
    """

    def __init__(self, path: str | Path):
        if not Path(path).is_file():
            raise UsageError(f"pilot model {path} is missing; train one with `swiftros train policy` or name another")
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = 1
        options.inter_op_num_threads = 1
        options.add_session_config_entry("session.intra_op.allow_spinning", "0")
        try:
            self._session = onnxruntime.InferenceSession(str(path), options, providers=["CPUExecutionProvider"])
        except Exception as error:  # the exception types of onnxruntime differ between releases
            raise UsageError(f"pilot model {path} cannot be loaded: {excerpt(str(error))}") from error
        inputs, outputs = self._session.get_inputs(), self._session.get_outputs()
        signature = [(value.type, value.shape) for value in (*inputs, *outputs)]
        if signature != [("tensor(float)", [1, OBSERVATION_SIZE]), ("tensor(float)", [1, ACTION_SIZE])]:
            shapes = [excerpt(f"{value.name} {value.shape} {value.type}") for value in (*inputs, *outputs)]
            raise UsageError(f"{path} is not a pilot: it has {', '.join(shapes)}; needed is [1, 31] -> [1, 4] float")
        self._input = inputs[0].name
        try:
            action = self.act(np.zeros(OBSERVATION_SIZE))  # the first inference allocates memory and is slow
        except Exception as error:
            raise UsageError(f"pilot model {path} cannot be run: {excerpt(str(error))}") from error
        if action.shape != (ACTION_SIZE,) or not np.isfinite(action).all():
            raise UsageError(f"pilot model {path} is damaged: it does not return {ACTION_SIZE} finite numbers")

    def act(self, observation) -> np.ndarray:
        """Return the raw action (4,) for an observation (31,)."""
        actions = self._session.run(None, {self._input: np.asarray(observation, dtype=np.float32)[None]})[0]
        return np.asarray(actions)[0]
