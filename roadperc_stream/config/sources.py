"""Stages of the user's own in the configuration: the source of each one, with its version and digest."""

import hashlib
import importlib
import sys
from collections.abc import Iterator
from functools import cache
from importlib.machinery import ModuleSpec
from importlib.metadata import packages_distributions, version
from importlib.util import find_spec
from pathlib import Path

from roadperc_stream.config.stages import BUILT_IN, OWN_STAGES, ReplayConfig
from roadperc_stream.errors import ConfigError
from roadperc_stream.system.text import failure


def implementations(cfg: ReplayConfig) -> Iterator[tuple[str, str]]:
    """Stage and ``MODULE:NAME`` of each own stage of a configuration."""
    named = ((stage, getattr(cfg, stage).implementation) for stage in OWN_STAGES)
    return ((stage, name) for stage, name in named if name != BUILT_IN)


def with_sources(cfg: ReplayConfig) -> ReplayConfig:
    """The configuration with the version and digest of the source of each own stage.

    The module itself is not imported, the packages that contain it are. The working directory is searched last.

    Raises:
        ConfigError: a module is not found, or its source is not the one that the configuration names.
    """
    changed = {}
    for stage, name in implementations(cfg):
        key, section = f"{stage}.implementation", getattr(cfg, stage)
        spec = _spec(key, name)
        found, expected = _source(spec), section.implementation_source
        if expected not in ("", found):
            raise ConfigError(
                f"{key}: {spec.origin} changed: found {found}, expected {expected}; "
                f"restore that source, or remove {key}_source from the configuration"
            )
        changed[stage] = section.model_copy(update={"implementation_source": found})
    return cfg.model_copy(update=changed)


def _spec(key: str, name: str) -> ModuleSpec:
    """Where Python finds the module of ``MODULE:NAME``."""
    module = name.partition(":")[0]
    spec = _find(key, module)
    here = str(Path.cwd())
    if spec is None and here not in sys.path:
        sys.path.append(here)  # last, so that no file there replaces an installed module
        importlib.invalidate_caches()
        spec = _find(key, module)
    if spec is None:
        raise ConfigError(f"{key}: no module {module!r}; install it, or run the command in the folder of its file")
    if not spec.has_location or spec.origin is None:
        raise ConfigError(f"{key}: module {module!r} has no source file; name the module of the stage")
    return spec


def _find(key: str, module: str) -> ModuleSpec | None:
    try:
        return find_spec(module)
    except ModuleNotFoundError:
        return None
    except (Exception, SystemExit) as error:  # a package that contains the module can fail in any way
        raise ConfigError(f"{key}: the package of {module!r} cannot be imported: {failure(error, '')}") from error


def _source(spec: ModuleSpec) -> str:
    """Distribution and version, if the module has them, and the digest of its file."""
    digest = hashlib.sha256(Path(str(spec.origin)).read_bytes()).hexdigest()
    names = _distributions().get(spec.name.partition(".")[0], ())
    return ", ".join((*(f"{name} {version(name)}" for name in sorted(set(names))), f"sha256 {digest}"))


_distributions = cache(packages_distributions)
"""Distributions by the name of a package in them; the search takes 0.2 s."""
