"""Loaded networks: onnxruntime with bit-identical results, or OpenCV where the extra is not installed."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import cache
from resource import RLIM_INFINITY, RLIMIT_DATA, getrlimit, setrlimit
from threading import Lock
from typing import Any, Final, Protocol

import cv2
import numpy as np
import psutil

from roadperc_stream.errors import ConfigError
from roadperc_stream.formats.images import quiet_opencv
from roadperc_stream.geometry import Float32

from .description import Network

_INSTALL: Final = "pip install '.[networks]' in the project's folder"
_MOST_BYTES: Final = 2 << 30
"""Memory of the loading, and of all runs at a time: a small file may describe constants of any size."""
_NO_MEMORY: Final = ("bad_alloc", "bad allocation", "Available memory", "nsufficient memory", "Failed to allocate")
"""Parts of the libraries' messages."""
_NUMBERS: Final = tuple(f"tensor({kind}" for kind in ("float)", "double)", "float16)", "int", "uint"))
"""Beginnings of the types that numpy reads."""


class Session(Protocol):
    """A loaded network; several threads may run it at the same time."""

    runtime: str
    """Library and version."""
    outputs: list[str]
    """Names of the outputs that ``run`` returns."""

    def run(self, pixels: Float32) -> list[Float32]:
        """Return the outputs, in the order of the TOML file, or of the model.

        Raises:
            ConfigError: an operation fails, is not supported, or needs too much memory.
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
        options.add_session_config_entry("session.use_env_allocators", "1")
        self.runtime = f"onnxruntime {library.__version__}"
        _limit_runs(library)
        try:
            with limited_memory():
                self._session = library.InferenceSession(network.model, options, providers=["CPUExecutionProvider"])
        except Exception as error:  # its errors have no common class
            raise _unreadable(network, str(error), f"{self.runtime} cannot load it") from error
        self._input = _require_input(network, self._session.get_inputs())
        kinds = {output.name: output.type for output in self._session.get_outputs()}
        self.outputs = _require_outputs(network, list(kinds))
        for name in self.outputs:
            if not kinds[name].startswith(_NUMBERS):
                raise ConfigError(f"{_file(network)}: output {name} is {kinds[name]}, expected a tensor of numbers")
        self._network = network

    def run(self, pixels: Float32) -> list[Float32]:
        """Return the outputs, as ``Session``."""
        try:
            found: list[Float32] = self._session.run(self.outputs, {self._input: pixels})
        except Exception as error:  # its errors have no common class
            raise _unreadable(self._network, str(error), f"{self.runtime} cannot run it") from error
        return found


@cache
def _limit_runs(library: Any) -> None:
    """Limit the memory of all sessions' runs together."""
    place = library.OrtMemoryInfo("Cpu", library.OrtAllocatorType.ORT_ARENA_ALLOCATOR, 0, library.OrtMemType.DEFAULT)
    library.create_and_register_allocator(place, library.OrtArenaCfg({"max_mem": _MOST_BYTES}))


@contextmanager
def limited_memory() -> Iterator[None]:
    """Limit the memory that the process may request during the block; for a block without other threads.

    Only Linux counts it.
    """
    used, before = getattr(psutil.Process().memory_info(), "data", None), getrlimit(RLIMIT_DATA)
    if used is None:
        yield
        return
    limits = [used + _MOST_BYTES, *(limit for limit in before if limit != RLIM_INFINITY)]
    setrlimit(RLIMIT_DATA, (min(limits), before[1]))
    try:
        yield
    finally:
        setrlimit(RLIMIT_DATA, before)


class _OpenCvSession:
    """OpenCV's own runtime: slower, and without support for some models."""

    def __init__(self, network: Network) -> None:
        self.runtime = f"cv2.dnn {cv2.__version__}"
        try:
            with quiet_opencv(), limited_memory():
                self._net = cv2.dnn.readNetFromONNX(np.frombuffer(network.model, np.uint8))
            names = list(self._net.getUnconnectedOutLayersNames())
        except Exception as error:  # also ValueError and MemoryError
            raise _unreadable(network, _why(error), f"{self.runtime} cannot load it; {_INSTALL}") from error
        self._network, self._lock = network, Lock()
        self.outputs = _require_outputs(network, names)

    def run(self, pixels: Float32) -> list[Float32]:
        """Return the outputs, as ``Session``."""
        try:
            with self._lock:  # a cv2.dnn.Net keeps its input
                self._net.setInput(pixels)
                return [np.asarray(found, np.float32) for found in self._net.forward(self.outputs)]
        except Exception as error:  # as in __init__
            fault = f"{self.runtime} cannot run it with input {_words(pixels.shape)}; {_INSTALL}"
            raise _unreadable(self._network, _why(error), fault) from error


def _why(error: Exception) -> str:
    return str(error.err if isinstance(error, cv2.error) else error)


def _unreadable(network: Network, why: str, fault: str) -> ConfigError:
    if any(words in why for words in _NO_MEMORY):
        why = f"it needs more than {_MOST_BYTES >> 30} GiB of memory; if the model is the right one, pass --threads 1"
    return ConfigError(f"{_file(network)}: {fault}: {' '.join(why.split())[:300]}")


def _require_input(network: Network, inputs: Sequence[Any]) -> str:
    """Return the name of the model's only input, after comparing its shape and type."""
    if len(inputs) != 1:
        names = ", ".join(item.name for item in inputs)
        raise ConfigError(f"{_file(network)}: {len(inputs)} inputs ({names}), expected one image")
    found, expected = inputs[0], network.keys.input.shape()
    fits = len(found.shape) == len(expected) and all(
        have == want for have, want in zip(found.shape, expected, strict=True) if isinstance(have, int)
    )
    if not fits or found.type != "tensor(float)":
        raise ConfigError(
            f"{_file(network)}: input {found.name} is {_words(found.shape)} {found.type}, but {network.path} describes "
            f"{_words(expected)} tensor(float) by input.size and input.layout; is it the right model?"
        )
    return str(found.name)


def _require_outputs(network: Network, names: list[str]) -> list[str]:
    """Return the names of the wanted outputs."""
    if not names:
        raise ConfigError(f"{_file(network)}: has no outputs; export the model again")
    missing = [name for name in network.keys.output.names if name not in names]
    if missing:
        raise ConfigError(
            f"{_file(network)}: outputs {', '.join(names)}, but {network.path} names {', '.join(missing)}; "
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
            f"{_file(network)}: output {name} is {_words(found)}, but decoder {keys.decoder} with {len(keys.classes)} "
            f"classes in {network.path} expects {expected}"
        )


def _file(network: Network) -> str:
    return str(network.path.parent / network.keys.file)


def _words(shape: Sequence[object]) -> str:
    return f"[{', '.join(map(str, shape))}]"
