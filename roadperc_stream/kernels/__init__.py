"""Inner loops that numpy and OpenCV calls do not express well, compiled by Cython if there is a C compiler.

``NAME_compiled.pyx`` becomes an extension module for every Python from 3.11 on (stable ABI). ``NAME_plain.py`` has the
same functions in numpy and OpenCV, with the same bits. This module selects the compiled functions, or all plain ones if
an extension is missing. The PNG readers have no plain form: ``formats.png`` checks ``COMPILED`` and else uses OpenCV.

A kernel does elementwise or integer work, or sums in a stated order. It is compiled without fast-math and without
contraction, and releases the interpreter's lock. Tests compare both forms.
"""

from typing import TYPE_CHECKING

try:
    from roadperc_stream.kernels.png_compiled import reverse_filters, reverse_to_grey

    if not TYPE_CHECKING:  # the plain functions have the annotations
        from roadperc_stream.kernels.lanes_compiled import follow
        from roadperc_stream.kernels.objects_compiled import divided
        from roadperc_stream.kernels.occupancy_compiled import count_points
        from roadperc_stream.kernels.odometry_compiled import align_patches
        from roadperc_stream.kernels.stereo_compiled import disparity_errors, doubled, refined_disparities, seen_by_both
        from roadperc_stream.kernels.surface_compiled import median_places, normal_equations, solve_band
    COMPILED = True
except ImportError:
    from roadperc_stream.kernels.lanes_plain import follow
    from roadperc_stream.kernels.objects_plain import divided
    from roadperc_stream.kernels.occupancy_plain import count_points
    from roadperc_stream.kernels.odometry_plain import align_patches
    from roadperc_stream.kernels.stereo_plain import disparity_errors, doubled, refined_disparities, seen_by_both
    from roadperc_stream.kernels.surface_plain import median_places, normal_equations, solve_band

    COMPILED = False
