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


def node(operation, inputs=("image",), output="y"):
    return b"".join([*(field(1, name) for name in inputs), field(2, output), field(4, operation)])


def info(number, name, of_type):
    """A graph's input (11) or output (12); the runtime infers an empty type."""
    return field(number, field(1, name) + (field(2, of_type) if of_type else b""))


def model(*nodes, outputs=("y",), of_type=b""):
    graph = b"".join(field(1, each) for each in nodes) + field(2, "graph") + info(11, "image", tensor(IMAGE))
    graph += b"".join(info(12, name, of_type) for name in outputs)
    return field(1, 8) + field(8, field(1, "") + field(2, 17)) + field(7, graph)


SAME = model(node("Relu"), of_type=tensor(IMAGE))
"""Its output is the image."""
