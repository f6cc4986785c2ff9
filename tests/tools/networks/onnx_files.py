"""Small ONNX files, written field by field as protobuf (https://github.com/onnx/onnx/blob/main/onnx/onnx.proto)."""

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
        return varint(number << 3) + varint(value)
    data = value.encode() if isinstance(value, str) else value
    return varint(number << 3 | 2) + varint(len(data)) + data


def tensor(shape):
    """The type of a tensor of float32."""
    return field(1, field(1, 1) + field(2, b"".join(field(1, field(1, side)) for side in shape)))


def model(operation, outputs=("y",)):
    """A model of one operation on the image."""
    node = field(1, "image") + field(2, "y") + field(4, operation)
    infos = [(11, "image"), *((12, name) for name in outputs)]
    graph = field(1, node) + field(2, "graph")
    graph += b"".join(field(number, field(1, name) + field(2, tensor(IMAGE))) for number, name in infos)
    return field(1, 8) + field(8, field(1, "") + field(2, 17)) + field(7, graph)


SAME = model("Relu")
"""Its output is the image."""
