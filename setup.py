"""The compiled inner loops; pyproject.toml has the rest of the installation."""

from pathlib import Path

from Cython.Build import cythonize
from setuptools import Extension, setup

KERNELS = Path("roadperc_stream/chain/kernels")
SHARED = KERNELS / "_cyutility.c"
"""What Cython's modules have in common, compiled once instead of in each of them; written by Cython."""
FATAL_OUTPUT = Path("roadperc_stream/system/fatal_output.pyx")
"""Commands import it before anything else, so it does without SHARED, whose package imports numpy."""
OLDEST_PYTHON = "cp311"
"""One extension for it and all later ones: only the stable ABI is used."""
STABLE_ABI = ("Py_LIMITED_API", "0x030B0000")
SAME_BITS = ("-O3", "-g0", "-ffp-contract=off", "-fno-trapping-math", "-fno-math-errno")
"""No -march=native and no -ffast-math: every machine computes the same. That nobody asks for the flags which a number
raises or the error it sets lets loops with conditions and roots become vectors, with the same numbers."""


def module(source: Path) -> str:
    """Name of the module that a source becomes."""
    return ".".join(source.with_suffix("").parts)


def kernel(source: Path) -> Extension:
    """A source and how it is compiled."""
    return Extension(
        module(source),
        [source.as_posix()],
        define_macros=[STABLE_ABI],
        extra_compile_args=list(SAME_BITS),
        py_limited_api=True,
    )


def kernels() -> list[Extension]:
    """Optional: where they cannot be compiled, the package is installed without them."""
    found: list[Extension] = cythonize(
        [kernel(source) for source in (SHARED, *sorted(KERNELS.glob("*.pyx")))],
        shared_utility_qualified_name=module(SHARED),
        language_level=3,
        quiet=True,
    )
    found += cythonize([kernel(FATAL_OUTPUT)], language_level=3, quiet=True)
    for extension in found:
        extension.optional = True  # not kept by cythonize
    return found


setup(ext_modules=kernels(), options={"bdist_wheel": {"py_limited_api": OLDEST_PYTHON}})
