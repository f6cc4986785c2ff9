"""Small ONNX files, written field by field as protobuf (https://github.com/onnx/onnx/blob/main/onnx/onnx.proto)."""

import struct

FLOAT, INT64 = 1, 7
IMAGE = (1, 3, 8, 16)
"""Shape of the models' only input, ``image``."""


def varint(number):
    parts = bytearray()
    while number > 127:
        parts.append(number & 127 | 128)
        number >>= 7
    return bytes((*parts, number))


def field(number, value):
    """A field: an integer, text, or bytes such as another message."""
    if isinstance(value, int):
        return varint(number << 3) + varint(value % 2**64)
    data = value.encode() if isinstance(value, str) else value
    return varint(number << 3 | 2) + varint(len(data)) + data


def tensor(shape, kind=FLOAT):
    """The type of a tensor."""
    return field(1, field(1, kind) + field(2, b"".join(field(1, field(1, side)) for side in shape)))


def info(name, of_type=b""):
    """A graph's input or output; the runtime infers a missing type."""
    return field(1, name) + (field(2, of_type) if of_type else b"")


def constant(name, *values, scalar=False):
    """A constant of int64."""
    data = field(2, INT64) + field(8, name) + field(9, struct.pack(f"<{len(values)}q", *values))
    return data if scalar else field(1, len(values)) + data


def node(operation, inputs, outputs, **attributes):
    """A node; an attribute is an integer, or the bytes of a graph."""
    parts = [field(1, name) for name in inputs] + [field(2, name) for name in outputs] + [field(4, operation)]
    for name, value in attributes.items():
        at, kind = (3, 2) if isinstance(value, int) else (6, 5)
        parts.append(field(5, field(1, name) + field(at, value) + field(20, kind)))
    return b"".join(parts)


def graph(nodes, inputs, outputs, constants=()):
    parts = [(1, nodes), (2, ["graph"]), (5, constants), (11, inputs), (12, outputs)]
    return b"".join(field(number, each) for number, several in parts for each in several)


def model(nodes, outputs, constants=()):
    found = graph(nodes, [info("image", tensor(IMAGE))], outputs, constants)
    return field(1, 8) + field(8, field(1, "") + field(2, 17)) + field(7, found)


SAME = model([node("Relu", ["image"], ["y"])], [info("y", tensor(IMAGE))])
"""Its output is the image."""
RANDOM = model([node("RandomUniformLike", ["image"], ["y"])], [info("y", tensor(IMAGE))])


def endless():
    """A model whose loop has 2**60 steps."""
    names = ("step", INT64), ("more", 9), ("x", FLOAT)
    inputs = [info(name, tensor((), kind) if kind != FLOAT else tensor(IMAGE)) for name, kind in names]
    outputs = [info("more_out", tensor((), 9)), info("x_out", tensor(IMAGE))]
    body = graph([node("Identity", ["more"], ["more_out"]), node("Sin", ["x"], ["x_out"])], inputs, outputs)
    loop = node("Loop", ["steps", "", "image"], ["y"], body=body)
    return model([loop], [info("y", tensor(IMAGE))], [constant("steps", 2**60, scalar=True)])
