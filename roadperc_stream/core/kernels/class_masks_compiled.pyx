# cython: language_level=3, boundscheck=False, wraparound=False, cdivision=True
"""The pixels of a class: compared with each of its few tags, a row at a time, which vectors do."""

from libc.stdint cimport uint8_t
from libc.string cimport memset

from roadperc_stream.core.kernels.class_masks_plain import require_belonging

cdef enum:
    FEW = 8  # tags, up to which comparing takes less time than looking each pixel up


cdef void _compare(const uint8_t* tags, const uint8_t* own, int count, uint8_t* marks, Py_ssize_t width) noexcept nogil:
    cdef Py_ssize_t x
    cdef uint8_t tag
    cdef int k
    memset(marks, 0, width)
    for k in range(count):
        tag = own[k]
        for x in range(width):
            marks[x] |= tags[x] == tag


cdef void _look_up(const uint8_t* tags, const uint8_t* of_class, uint8_t* marks, Py_ssize_t width) noexcept nogil:
    cdef Py_ssize_t x
    for x in range(width):
        marks[x] = of_class[tags[x]]


def mark_class(const uint8_t[:, ::1] tags, const uint8_t[::1] of_class, uint8_t[:, ::1] marks):
    cdef Py_ssize_t height = tags.shape[0], width = tags.shape[1], y
    cdef uint8_t own[256]
    cdef int tag, count = 0
    require_belonging((height, width), (of_class.shape[0],), (marks.shape[0], marks.shape[1]))
    for tag in range(256):
        if of_class[tag]:
            own[count] = <uint8_t>tag
            count += 1
    with nogil:
        for y in range(height if width else 0):
            if count <= FEW:
                _compare(&tags[y, 0], own, count, &marks[y, 0], width)
            else:
                _look_up(&tags[y, 0], &of_class[0], &marks[y, 0], width)
