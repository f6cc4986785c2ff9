"""Loaded networks: onnxruntime with bit-identical results, or OpenCV where the extra is not installed."""

from collections.abc import Sequence
from threading import Lock
from typing import Any, Final, Protocol

import cv2
import numpy as np

from roadperc_stream.errors import ConfigError
from roadperc_stream.formats.images import quiet_opencv
from roadperc_stream.geometry import Float32

from .description import Network

_INSTALL: Final = "pip install '.[networks]' in the project's folder"
_NUMBERS: Final = tuple(f"tensor({kind}" for kind in ("float)", "double)", "float16)", "int", "uint"))
"""Beginnings of onnxruntime's names for tensors of numbers."""


class Session(Protocol):
    """A loaded network; several threads may run it at the same time."""

    runtime: str
    """Library and version."""
    outputs: list[str]
    """Names of the outputs that ``run`` returns."""

    def run(self, pixels: Float32) -> list[Float32]:
        """Return the outputs, in the order of the TOML file, or of the model.

        Raises:
            ConfigError: an operation fails or is not supported.
        """
        ...


def open_session(network: Network) -> Session:
    """Load a network, and compare its input and outputs with the TOML file.

    Raises:
        ConfigError: it cannot be loaded, or does not fit; the message has both shapes.
    """
    try:
        import onnxruntime  # noqa: PLC0415 - an extra
    except ImportError:
        return _OpenCvSession(network)
    return _OnnxSession(network, onnxruntime)


class _OnnxSession:
    """One thread and a fixed order of operations: the same bytes in every process, alone or with other frames."""

    def __init__(self, network: Network, library: Any) -> None:
        options = library.SessionOptions()
        options.intra_op_num_threads = options.inter_op_num_threads = 1
        options.execution_mode = library.ExecutionMode.ORT_SEQUENTIAL
        options.graph_optimization_level = library.GraphOptimizationLevel.ORT_ENABLE_ALL
        options.log_severity_level = 4
        self._network, self.runtime = network, f"onnxruntime {library.__version__}"
        try:
            self._session = library.InferenceSession(network.model, options, providers=["CPUExecutionProvider"])
        except Exception as error:  # its errors have no common class
            raise _unusable(network, f"{self.runtime} cannot load it", error) from error
        self._input = _require_input(network, self._session.get_inputs())
        kinds = {output.name: output.type for output in self._session.get_outputs()}
        self.outputs = _require_outputs(network, list(kinds))
        for name in self.outputs:
            if not kinds[name].startswith(_NUMBERS):
                raise ConfigError(f"{network.model_path}: output {name} is {kinds[name]}, expected a tensor of numbers")

    def run(self, pixels: Float32) -> list[Float32]:
        """Return the outputs, as ``Session``."""
        try:
            found: list[Float32] = self._session.run(self.outputs, {self._input: pixels})
        except Exception as error:  # its errors have no common class
            raise _unusable(self._network, f"{self.runtime} cannot run it", error) from error
        return found


class _OpenCvSession:
    """OpenCV's own runtime: slower, and without support for some models."""

    def __init__(self, network: Network) -> None:
        self._network, self._lock, self.runtime = network, Lock(), f"cv2.dnn {cv2.__version__}"
        try:
            with quiet_opencv():
                self._net = cv2.dnn.readNetFromONNX(np.frombuffer(network.model, np.uint8))
            names = list(self._net.getUnconnectedOutLayersNames())
        except cv2.error as error:
            raise _unusable(network, f"{self.runtime} cannot load it; {_INSTALL}", error.err) from error
        self.outputs = _require_outputs(network, names)

    def run(self, pixels: Float32) -> list[Float32]:
        """Return the outputs, as ``Session``."""
        try:
            with self._lock:  # a cv2.dnn.Net keeps its input
                self._net.setInput(pixels)
                return [np.asarray(output, np.float32) for output in self._net.forward(self.outputs)]
        except cv2.error as error:
            fault = f"{self.runtime} cannot run it with input {_words(pixels.shape)}; {_INSTALL}"
            raise _unusable(self._network, fault, error.err) from error


def _unusable(network: Network, fault: str, why: object) -> ConfigError:
    return ConfigError(f"{network.model_path}: {fault}: {' '.join(str(why).split())[:300]}")


def _require_input(network: Network, inputs: Sequence[Any]) -> str:
    """Return the name of the model's only input, after comparing its shape and type."""
    if len(inputs) != 1:
        names = ", ".join(item.name for item in inputs)
        raise ConfigError(f"{network.model_path}: {len(inputs)} inputs ({names}), expected one image")
    found, expected = inputs[0], network.keys.input.shape()
    fits = len(found.shape) == len(expected) and all(
        have == want for have, want in zip(found.shape, expected, strict=True) if isinstance(have, int)
    )
    if not fits or found.type != "tensor(float)":
        raise ConfigError(
            f"{network.model_path}: input {found.name} is {_words(found.shape)} {found.type}, but {network.path} "
            f"describes {_words(expected)} tensor(float) by input.size and input.layout; is it the right model?"
        )
    return str(found.name)


def _require_outputs(network: Network, names: list[str]) -> list[str]:
    """Return the names of the wanted outputs."""
    if not names:
        raise ConfigError(f"{network.model_path}: has no outputs; export the model again")
    missing = [name for name in network.keys.output.names if name not in names]
    if missing:
        raise ConfigError(
            f"{network.model_path}: outputs {', '.join(names)}, but {network.path} names {', '.join(missing)}; "
            "change the output's names, or is it another model?"
        )
    return list(network.keys.output.names) or names


def require_output(network: Network, name: str, found: Sequence[int], expected: str, *, fits: bool) -> None:
    """Check the shape of an output.

    Raises:
        ConfigError: it does not fit; the message has both shapes.
    """
    if not fits:
        keys = network.keys.output
        raise ConfigError(
            f"{network.model_path}: output {name} is {_words(found)}, but decoder {keys.decoder} with "
            f"{len(keys.classes)} classes in {network.path} expects {expected}"
        )


def _words(shape: Sequence[object]) -> str:
    return f"[{', '.join(map(str, shape))}]"
