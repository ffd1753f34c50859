"""Writes a scene as YAML: values with their units, each entry below a comment that names its source."""

from __future__ import annotations

import re
from collections.abc import Mapping
from textwrap import indent, wrap
from typing import Any

import yaml

from softrobot_twin.conversion.scene_tree import TABLE

SOURCE = "#"
"""Key of an entry for the comment above it: a list of texts has a line for each."""
_UNITS: dict[str, str] = TABLE["units"]
_WIDTH = 100
_NUMBERED = re.compile(rf"^( *)- '{SOURCE}': \[(\d+)\]\n +", re.MULTILINE)
# A key with a number, or numbers that end on the same line.
_WITH_UNIT = re.compile(rf"^[ -]*({'|'.join(_UNITS)}): [-.\[{{\d][^#\n]*(?<!,)$", re.MULTILINE)


def scene_yaml(scene: Mapping[str, Any], head: list[str]) -> str:
    """The text of a scene.

    Args:
        scene: Its sections: values, mappings, and lists of mappings.
        head: Lines of the comment at the top.
    """
    comments: list[list[str]] = []
    text = yaml.safe_dump(_numbered(scene, comments), default_flow_style=None, sort_keys=False, width=_WIDTH,
                          allow_unicode=True)  # fmt: skip
    text = _NUMBERED.sub(lambda found: _comment(comments[int(found[2])], found[1]) + f"{found[1]}- ", text)
    text = _WITH_UNIT.sub(lambda found: f"{found[0]}  # {_UNITS[found[1]]}", text)
    return _comment(head) + re.sub(r"^(\w+:)$", r"\n\1", text, flags=re.MULTILINE)


def _numbered(value: Any, comments: list[list[str]]) -> Any:
    """A value with numbers in place of its comments, which are kept; no part is in it twice, so YAML has no aliases."""
    if isinstance(value, Mapping):
        own = {key: _numbered(part, comments) for key, part in value.items() if key != SOURCE}
        if SOURCE in value:
            comments.append(value[SOURCE])
            own = {SOURCE: [len(comments) - 1]} | own
        return own
    return [_numbered(part, comments) for part in value] if isinstance(value, list | tuple) else value


def _comment(texts: list[str], space: str = "") -> str:
    lines = [line for text in texts for line in wrap(text, _WIDTH - 2 - len(space))]
    return indent("".join(f"{line}\n" for line in lines), f"{space}# ")
