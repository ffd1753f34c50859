"""Changes values in the text of a scene file and keeps everything else: order, layout, comments."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any, NamedTuple

import yaml

from softrobot_twin.errors import SceneError
from softrobot_twin.scene.loading import read_yaml, scene_from_mapping, written_out
from softrobot_twin.scene.patterns import as_written
from softrobot_twin.scene.refusal_messages import dotted, parts
from softrobot_twin.scene.scene_parameters import changed_scene, parameters, value_at
from softrobot_twin.scene.schema import Scene

_ANCHOR = re.compile(r"&(\w+)\s+(\{[^{}]*\}|\[[^\[\]]*\]|[^\s#]+)")


class EditedValue(NamedTuple):
    """A value that is written into a scene file.

    Attributes:
        value: A number in its unit, or a section, list or word as a file has it.
        comment: What is said of it at the end of its line.
    """

    value: Any
    comment: str


def edited_text(text: str, scene: Scene, numbers: Mapping[str, EditedValue]) -> str:
    """The text of a scene file with other values.

    A key that the file leaves out is added to its section. Repeated entries are written out, where their
    copies get numbers of their own.

    Args:
        text: The text of the file.
        scene: The scene that it holds.
        numbers: New values by their keys, such as ``cables[0].offset``; a section comes before what is in it.

    Raises:
        SceneError: The text cannot be changed so that the file has these values.
    """
    places = {tuple(parts(key)): number for key, number in numbers.items()}
    shared = _shared(scene, places)
    text = _written_out(text, scene, {place: number for place, number in places.items()
                                      if place not in shared})  # fmt: skip
    places = {shared.get(place, place): number for place, number in places.items()}
    comments: dict[int, list[str]] = {}
    for place, number in sorted(places.items(), key=lambda one: (len(one[0]), str(one[0]))):
        text = _with_value(text, place, number.value, place in shared.values(), scene)
    root = yaml.compose(text, Loader=yaml.SafeLoader)
    for place, number in places.items():
        line = _found(root, place, place in shared.values())[0].end_mark.line
        comments.setdefault(line, []).append(number.comment)
    lines = text.split("\n")
    for line, words in comments.items():
        said = "; ".join(dict.fromkeys(words))
        lines[line] += f"; {said}" if " #" in lines[line] else f"  # {said}"
    text = "\n".join(lines)
    wanted = changed_scene(scene, {key: numbers[key].value for key in sorted(numbers, key=len)})
    if scene_from_mapping(read_yaml(text), scene.path) != wanted:
        raise SceneError(scene.path, next(iter(numbers)), "", "", "cannot be written into this file")
    return text


def _shared(scene: Scene, places: Mapping[tuple, EditedValue]) -> dict[tuple, tuple]:
    """Where the file has the numbers that are the same in all copies of a repeated entry."""
    copies: dict[tuple, list[tuple]] = {}
    for one in parameters(scene):
        place = tuple(parts(one.key))
        copies.setdefault(as_written(scene.source.mapping, place)[0], []).append(place)
    alone = {written[:2] for written, own in copies.items()
             if len({places[one].value if one in places else None for one in own}) > 1}  # fmt: skip
    return {one: written for written, own in copies.items()
            if len(own) > 1 and own[0] in places and written[:2] not in alone for one in own}  # fmt: skip


def _found(root: yaml.Node, place: tuple, with_merged: bool = False) -> tuple[yaml.Node, tuple]:
    """The node at a place or the innermost one around it, and the rest of the place that is missing;
    perhaps also one that is merged there by ``<<``."""
    node = root
    for depth, step in enumerate(place):
        if isinstance(node, yaml.MappingNode):
            inside = _in_mapping(node, step, with_merged)
        else:
            inside = node.value[step] if isinstance(node, yaml.SequenceNode) else None
        if inside is None:
            return node, place[depth:]
        node = inside
    return node, ()


def _in_mapping(node: yaml.MappingNode, step: Any, with_merged: bool) -> yaml.Node | None:
    """What a mapping has for a key."""
    own = dict((key.value, value) for key, value in node.value)
    merged = own.get("<<")
    if step in own or not with_merged or not isinstance(merged, yaml.MappingNode):
        return own.get(step)
    return _in_mapping(merged, step, True)


def _with_value(text: str, place: tuple, value: Any, with_merged: bool, scene: Scene) -> str:
    """The text with a value at a place; see `_found`. A vector that is missing is as in the scene."""
    node, missing = _found(yaml.compose(text, Loader=yaml.SafeLoader), place, with_merged)
    if not missing:
        begin, end = node.start_mark.index, _end_of(node)
        return text[:begin] + _flow(value) + text[end:]
    content: Any = value
    is_alone = not any(isinstance(step, int) for step in place[:-1])  # Vectors of entries are 0.
    usual = value_at(scene, dotted(place[:-1])) if is_alone and isinstance(place[-1], int) else (0.0,) * 3
    for step in reversed(missing[1:]):
        content = {step: content} if isinstance(step, str) else [content if k == step else usual[k]
                                                                  for k in range(3)]  # fmt: skip
    added = f"{missing[0]}: {_flow(content)}"
    if node.flow_style:
        end = node.end_mark.index - 1
        return text[:end].rstrip() + (", " if node.value else "") + added + text[end:]
    first, last = node.value[0][0], node.value[-1][1]
    line_end = text.find("\n", _end_of(last))
    line_end = len(text) if line_end < 0 else line_end
    return f"{text[:line_end]}\n{' ' * first.start_mark.column}{added}{text[line_end:]}"


def _end_of(node: yaml.Node) -> int:
    """Where the last scalar or bracket of a node ends."""
    if getattr(node, "flow_style", True) or not node.value:
        return node.end_mark.index
    last = node.value[-1]
    return _end_of(last[1] if isinstance(node, yaml.MappingNode) else last)


def _flow(value: Any) -> str:
    """A value on one line."""
    if isinstance(value, float):
        return _number(value)
    flow = yaml.safe_dump(value, default_flow_style=True, sort_keys=False, width=10_000).strip()
    return flow.removesuffix("...").strip()


def _number(value: float) -> str:
    """A number as YAML 1.1 reads it: an exponent needs a point and a sign."""
    word = repr(float(value))
    mantissa, letter, exponent = word.partition("e")
    if not letter:
        return word
    mantissa = mantissa if "." in mantissa else f"{mantissa}.0"
    return f"{mantissa}e{'' if exponent[0] in '+-' else '+'}{exponent}"


def _written_out(text: str, scene: Scene, places: Mapping[tuple, EditedValue]) -> str:
    """The text with copies in place of each repeated entry of which a number is changed."""
    mapping = read_yaml(text)
    copies = written_out(mapping, scene.path)
    repeated: dict[tuple, tuple] = {}
    for place in places:
        for depth, step in enumerate(place):
            if not isinstance(step, int):
                continue
            written, copy = as_written(scene.source.mapping, place[: depth + 1])
            entry = _value(mapping, written)
            if isinstance(entry, dict) and "repeat" in entry:
                repeated[written] = place[:depth]
                break
    for written, section in sorted(repeated.items(), key=lambda one: one[0][-1], reverse=True):
        node, _ = _found(yaml.compose(text, Loader=yaml.SafeLoader), written)
        own = [one for index, one in enumerate(_value(copies, section))
               if as_written(scene.source.mapping, (*section, index))[0] == written]  # fmt: skip
        begin = text.rfind("\n", 0, node.start_mark.index) + 1
        dash = text.index("-", begin)
        end = text.find("\n", _end_of(node))
        end = len(text) if end < 0 else end
        made = [" " * (dash - begin) + "- " + yaml.safe_dump(
            one, default_flow_style=True, sort_keys=False, width=10_000).strip() for one in own]
        head = " " * (dash - begin) + "# Written out: the copies have numbers of their own."
        anchors = dict(_ANCHOR.findall(text[begin:end]))
        text = text[:begin] + "\n".join([head, *made]) + text[end:]
        for name, content in anchors.items():
            # A backslash in the content is itself.
            text = re.sub(rf"\*{name}\b", content.replace("\\", r"\\"), text)
    return text


def _value(value: Any, place: tuple) -> Any:
    """What is at a place of nested lists and mappings; None where nothing is."""
    for step in place:
        try:
            value = value[step]
        except (KeyError, IndexError, TypeError):
            return None
    return value
