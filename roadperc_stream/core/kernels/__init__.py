"""Inner loops that no call of numpy or OpenCV expresses well, compiled by Cython where there is a C compiler.

``NAME_compiled.pyx`` becomes an extension module that every Python from 3.11 on loads (stable ABI), with its signatures
in ``NAME_compiled.pyi``. An installation without a compiler has none of them, and gets the same bits:

- ``NAME_plain.py`` has the same functions in numpy and OpenCV, and ``NAME.py`` takes the compiled ones if they can be
  imported: ``try: from ...NAME_compiled import f``, ``except ImportError: from ...NAME_plain import f``.
- Or its caller has another way to the same result, as OpenCV decodes every PNG.

So a kernel does elementwise or integer work, or sums in a stated order, and is compiled without fast-math and without
contraction. It releases the interpreter's lock. Tests hold both ways to each other.
"""
