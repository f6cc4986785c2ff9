# cython: language_level=3, boundscheck=False, wraparound=False, cdivision=True
"""Reverse the filters of a PNG's rows in place, and convert rows to grey while they are in the processor's cache.

Source of the filters: PNG specification (ISO/IEC 15948), clause 9. Every row is a byte that names its filter, then the
filtered bytes. A filter predicts a byte from the bytes one pixel to the left, one row above, and both.
"""

from libc.stdint cimport uint8_t, uint32_t

cdef enum:
    NONE
    SUB
    UP
    AVERAGE
    PAETH

cdef enum:  # in 1/32768: the weights that OpenCV passes to libpng's png_set_rgb_to_gray, 0.299 and 0.587
    RED = 9797
    GREEN = 19234
    BLUE = 3737
    WEIGHT_BITS = 15


cdef inline int _magnitude(int number) noexcept nogil:
    cdef int sign = number >> 31
    return (number ^ sign) - sign


cdef inline uint8_t _nearest(int left, int above, int corner) noexcept nogil:
    """The value nearest to left + above - corner; without branches, which the processor could not predict."""
    cdef int to_left = above - corner, to_above = left - corner
    cdef int to_corner = to_left + to_above
    to_left = _magnitude(to_left)
    to_above = _magnitude(to_above)
    to_corner = _magnitude(to_corner)
    cdef int use_above = -(to_above < to_left)
    left ^= (left ^ above) & use_above
    to_left ^= (to_left ^ to_above) & use_above
    cdef int use_corner = -(to_corner < to_left)
    return <uint8_t>(left ^ ((left ^ corner) & use_corner))


cdef inline void _sub(uint8_t* row, Py_ssize_t width, const int step) noexcept nogil:
    cdef uint8_t left[4]
    cdef Py_ssize_t x
    cdef int c
    for c in range(step):
        left[c] = 0
    for x in range(width):
        for c in range(step):
            left[c] += row[c]
            row[c] = left[c]
        row += step


cdef inline void _up(uint8_t* row, const uint8_t* above, Py_ssize_t length) noexcept nogil:
    cdef Py_ssize_t i
    for i in range(length):
        row[i] += above[i]


cdef inline void _average(uint8_t* row, const uint8_t* above, Py_ssize_t width, const int step) noexcept nogil:
    cdef uint8_t left[4]
    cdef Py_ssize_t x
    cdef int c
    for c in range(step):
        left[c] = 0
    for x in range(width):
        for c in range(step):
            left[c] = <uint8_t>(row[c] + ((<int>left[c] + <int>above[c]) >> 1))
            row[c] = left[c]
        row += step
        above += step


cdef inline void _paeth(uint8_t* row, const uint8_t* above, Py_ssize_t width, const int step) noexcept nogil:
    cdef uint8_t left[4]
    cdef uint8_t corner[4]
    cdef Py_ssize_t x
    cdef int c
    for c in range(step):
        left[c] = 0
        corner[c] = 0
    for x in range(width):
        for c in range(step):
            left[c] = <uint8_t>(row[c] + _nearest(left[c], above[c], corner[c]))
            corner[c] = above[c]
            row[c] = left[c]
        row += step
        above += step


cdef inline bint _reverse(uint8_t* line, const uint8_t* above, Py_ssize_t width, const int step) noexcept nogil:
    """Reverse the filter that the line's first byte names; False if it is unknown."""
    cdef int kind = line[0]
    cdef uint8_t* row = line + 1
    if kind == SUB:
        _sub(row, width, step)
    elif kind == UP:
        _up(row, above, width * step)
    elif kind == AVERAGE:
        _average(row, above, width, step)
    elif kind == PAETH:
        _paeth(row, above, width, step)
    return kind <= PAETH


cdef bint _reverse_of(uint8_t* line, const uint8_t* above, Py_ssize_t width, int step) noexcept nogil:
    """``_reverse``, compiled for each number of bytes per pixel."""
    if step == 1:
        return _reverse(line, above, width, 1)
    if step == 2:
        return _reverse(line, above, width, 2)
    if step == 3:
        return _reverse(line, above, width, 3)
    return _reverse(line, above, width, 4)


cdef inline uint8_t _grey_of(uint32_t red, uint32_t green, uint32_t blue) noexcept nogil:
    return <uint8_t>((RED * red + GREEN * green + BLUE * blue) >> WEIGHT_BITS)


cdef inline void _grey_row(const uint8_t* row, uint8_t* grey, Py_ssize_t width, const int step) noexcept nogil:
    cdef Py_ssize_t x
    for x in range(width):
        grey[x] = _grey_of(row[step * x], row[step * x + 1], row[step * x + 2])


cdef inline void _sub_to_grey(const uint8_t* row, uint8_t* grey, Py_ssize_t width, const int step) noexcept nogil:
    """Convert a row that the next row does not need; its own pixels are not written."""
    cdef uint8_t red = 0, green = 0, blue = 0
    cdef Py_ssize_t x
    for x in range(width):
        red += row[step * x]
        green += row[step * x + 1]
        blue += row[step * x + 2]
        grey[x] = _grey_of(red, green, blue)


cdef inline bint _line_to_grey(
    uint8_t* line, const uint8_t* above, bint needed_below, uint8_t* grey, Py_ssize_t width, const int step
) noexcept nogil:
    """Convert a line to grey; False if its filter is unknown."""
    if line[0] == SUB and not needed_below:
        _sub_to_grey(line + 1, grey, width, step)
        return True
    if not _reverse(line, above, width, step):
        return False
    _grey_row(line + 1, grey, width, step)
    return True


def reverse_filters(uint8_t[:, ::1] lines, int pixel_bytes):
    """Reverse the filters of all lines in place; False if one is unknown.

    Raises:
        ValueError: a pixel has not 1 to 4 bytes, or a line does not hold whole pixels.
    """
    cdef Py_ssize_t height = lines.shape[0], y
    cdef Py_ssize_t width = _width(lines.shape[1] - 1, pixel_bytes)
    cdef const uint8_t[::1] zeros = bytes(lines.shape[1])
    cdef const uint8_t* above = &zeros[0]
    cdef bint known = True
    with nogil:
        for y in range(height):
            known = _reverse_of(&lines[y, 0], above, width, pixel_bytes)
            if not known:
                break
            above = &lines[y, 1]
    return known


def reverse_to_grey(uint8_t[:, ::1] lines, int pixel_bytes, uint8_t[:, ::1] grey):
    """Convert lines whose pixels start with red, green and blue, and overwrite them; False if a filter is unknown.

    Raises:
        ValueError: a pixel has not 3 or 4 bytes, a line does not hold whole pixels, or ``grey`` has another size.
    """
    cdef Py_ssize_t height = lines.shape[0], y
    cdef Py_ssize_t width = _width(lines.shape[1] - 1, pixel_bytes)
    if pixel_bytes < 3 or grey.shape[0] != height or grey.shape[1] != width:
        raise ValueError(f"{height}x{width} pixels of {pixel_bytes} bytes to grey {grey.shape[0]}x{grey.shape[1]}: "
                         "expected one size and 3 or 4 bytes")
    cdef const uint8_t[::1] zeros = bytes(lines.shape[1])
    cdef const uint8_t* above = &zeros[0]
    cdef bint known = True, needed_below
    with nogil:
        for y in range(height):
            needed_below = y + 1 < height and lines[y + 1, 0] > SUB
            if pixel_bytes == 3:
                known = _line_to_grey(&lines[y, 0], above, needed_below, &grey[y, 0], width, 3)
            else:
                known = _line_to_grey(&lines[y, 0], above, needed_below, &grey[y, 0], width, 4)
            if not known:
                break
            above = &lines[y, 1]
    return known


cdef Py_ssize_t _width(Py_ssize_t length, int pixel_bytes) except -1:
    if not 1 <= pixel_bytes <= 4 or length < 1 or length % pixel_bytes:
        raise ValueError(f"lines of {length} bytes, pixels of {pixel_bytes}: expected whole pixels of 1 to 4 bytes")
    return length // pixel_bytes
