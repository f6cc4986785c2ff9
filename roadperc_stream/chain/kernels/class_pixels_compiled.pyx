# cython: language_level=3, boundscheck=False, wraparound=False, cdivision=True
"""The pixels of a class; ``class_pixels_plain`` documents the functions. Sizes that do not fit are a ValueError."""

import numpy as np

from libc.stdint cimport uint8_t

cdef enum:
    TAGS = 256
    AT_ONCE = 4  # tags compared in one pass
    BLOCK = 4096  # pixels that fit into the processor's first cache


cdef inline Py_ssize_t _mirrored(Py_ssize_t place, Py_ssize_t size) noexcept nogil:
    """Mirror an index one beyond the border back into the image."""
    if size == 1:
        return 0
    if place < 0:
        return 1
    return place if place < size else size - 2


cdef void _mark_four(
    const uint8_t* tags, Py_ssize_t count, const uint8_t* wanted, bint is_first, uint8_t* marked
) noexcept nogil:
    """Mark the pixels that have one of four tags; only the first call also clears the others."""
    cdef uint8_t a = wanted[0], b = wanted[1], c = wanted[2], d = wanted[3]
    cdef Py_ssize_t i
    if is_first:
        for i in range(count):
            marked[i] = (tags[i] == a) | (tags[i] == b) | (tags[i] == c) | (tags[i] == d)
    else:
        for i in range(count):
            marked[i] |= (tags[i] == a) | (tags[i] == b) | (tags[i] == c) | (tags[i] == d)


def mark(tags, const uint8_t[::1] of_class):
    """Compare many pixels at a time: a class has few tags."""
    cdef uint8_t wanted[TAGS + AT_ONCE]
    cdef int count = 0, tag
    cdef Py_ssize_t start = 0, size
    if of_class.shape[0] != TAGS:
        raise ValueError(f"of_class: expected 256 numbers, got {of_class.shape[0]}")
    for tag in range(TAGS):
        if of_class[tag]:
            wanted[count] = tag
            count += 1
    if not count:
        return np.zeros(tags.shape, np.uint8)
    for tag in range(AT_ONCE):  # fill the last group of four by repeating a tag
        wanted[count + tag] = wanted[count - 1]
    found = np.empty(tags.shape, np.uint8)
    cdef const uint8_t[::1] pixels = np.ascontiguousarray(tags).reshape(-1)
    cdef uint8_t[::1] marked = found.reshape(-1)
    with nogil:
        while start < pixels.shape[0]:
            size = min(pixels.shape[0] - start, BLOCK)
            for tag in range((count + AT_ONCE - 1) // AT_ONCE):
                _mark_four(&pixels[start], size, wanted + AT_ONCE * tag, tag == 0, &marked[start])
            start += size
    return found


def mark_together(const uint8_t[:, :] tags, const uint8_t[::1] of_class, int least, uint8_t[:, :] marked):
    cdef Py_ssize_t height = tags.shape[0], width = tags.shape[1], y, x, above, below, left, right
    cdef int together
    if marked.shape[0] != height or marked.shape[1] != width or not height * width or of_class.shape[0] != 256:
        raise ValueError(f"{height}x{width} tags, {marked.shape[0]}x{marked.shape[1]} marks and {of_class.shape[0]} "
                         "numbers of the class: expected one size, not empty, and 256")
    with nogil:
        for y in range(height):
            above, below = _mirrored(y - 1, height), _mirrored(y + 1, height)
            for x in range(width):
                marked[y, x] = 0
                if of_class[tags[y, x]]:
                    left, right = _mirrored(x - 1, width), _mirrored(x + 1, width)
                    together = of_class[tags[above, left]] + of_class[tags[above, x]] + of_class[tags[above, right]]
                    together += of_class[tags[y, left]] + 1 + of_class[tags[y, right]]
                    together += of_class[tags[below, left]] + of_class[tags[below, x]] + of_class[tags[below, right]]
                    marked[y, x] = together >= least
