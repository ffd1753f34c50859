"""Definitions of messages as text, which a file of messages contains beside them."""

from __future__ import annotations

from softrobot_twin.ros import topics

_SEPARATOR = "=" * 80
_PLAIN = {"float": "float32", "double": "float64", "boolean": "bool", "octet": "byte"} | {
    name: name for name in ("string", "int8", "uint8", "int16", "uint16", "int32", "uint32", "int64",
                            "uint64")
}  # fmt: skip
"""Types of fields that are no messages, and the words for them in a message file."""


def type_name(kind: type) -> str:
    """Full name of a type of messages, such as ``sensor_msgs/msg/JointState``.

    Args:
        kind: Class of the messages.
    """
    package, folder, *_ = kind.__module__.split(".")
    return f"{package}/{folder}/{kind.__name__}"


def definition(kind: type) -> str:
    """Definition of a type of messages (``ros2msg``), with those of all types inside it.

    Args:
        kind: The class that Python has for it.

    Raises:
        KeyError: It contains a field that is an array of fixed size, a bounded sequence or a wide string.
    """
    texts: dict[str, str] = {}
    _collect(kind, texts)
    (_, first), *others = texts.items()
    parts = [first, *(f"{_SEPARATOR}\nMSG: {name}\n{text}" for name, text in others)]
    return "".join(parts)


def _collect(kind: type, texts: dict[str, str]) -> None:
    key = topics.type_name(kind)
    if key in texts:
        return
    texts[key] = ""
    inner, lines = [], []
    for field, idl in kind.get_fields_and_field_types().items():
        name = idl.removeprefix("sequence<").removesuffix(">")
        item = name if "/" in name else _PLAIN[name]
        lines.append(f"{item if name == idl else item + '[]'} {field}\n")
        if "/" in item:
            inner.append(topics.class_named(item))
    texts[key] = "".join(lines)
    for item in inner:
        _collect(item, texts)
