"""YAML as scenes are written: ``on`` is a key, not the word for true, and a key stands once."""

from __future__ import annotations

import re
from typing import Any

import yaml

MOST_ENTRIES = 1_000_000
"""A text whose anchors, written out, make more entries than this is not read."""


class DuplicateKeyError(yaml.YAMLError):
    """A key stands twice in one section.

    Attributes:
        key: Dotted path of the key, such as ``cables[0].rate``.
        value: What stands there the second time.
        lines: Lines of both, counted from 1.
    """

    def __init__(self, key: str, value: str, lines: tuple[int, int]):
        self.key, self.value, self.lines = key, value, lines
        super().__init__(f"{key} stands twice, in lines {lines[0]} and {lines[1]}")


class _SceneYaml(yaml.SafeLoader):
    """Reads only ``true`` and ``false`` as truth values, as YAML 1.2 does."""


TRUTH = re.compile(r"^(?:true|True|TRUE|false|False|FALSE)$")
BOOL = "tag:yaml.org,2002:bool"
_MERGE = "tag:yaml.org,2002:merge"
_SceneYaml.yaml_implicit_resolvers = {
    first: [(tag, pattern) for tag, pattern in resolvers if tag != BOOL]
    for first, resolvers in yaml.SafeLoader.yaml_implicit_resolvers.items()
}
_SceneYaml.add_implicit_resolver(BOOL, TRUTH, "tTfF")


def read_yaml(text: str) -> Any:
    """What a scene's text holds.

    Args:
        text: The file's content.

    Returns:
        Mappings, sequences and values.

    Raises:
        yaml.YAMLError: The text is not YAML, or a key stands twice in one section.
    """
    try:
        loader = _SceneYaml(text)
        try:
            node = loader.get_single_node()
            if node is None:
                return None
            _check(node, "", {}, set())
            return loader.construct_document(node)
        finally:
            loader.dispose()
    except RecursionError:
        raise yaml.YAMLError("its sections are nested too deep") from None
    except (ValueError, OverflowError) as error:  # a date or a number that cannot be
        raise yaml.YAMLError(str(error)) from None


def _check(node: yaml.Node, key: str, counts: dict[int, int], above: set[int]) -> int:
    """Refuse keys that stand twice and anchors without end; the entries below, written out."""
    if id(node) in counts:
        return counts[id(node)]
    if id(node) in above:
        raise _marked("an anchor holds itself", node)
    above.add(id(node))
    count = 1
    if isinstance(node, yaml.SequenceNode):
        for index, item in enumerate(node.value):
            count += _check(item, f"{key}[{index}]", counts, above)
    elif isinstance(node, yaml.MappingNode):
        count += _check_section(node, key, counts, above)
    above.remove(id(node))
    if count > MOST_ENTRIES:
        raise _marked(f"anchors make more than {MOST_ENTRIES} entries of it", node)
    counts[id(node)] = count
    return count


def _check_section(
    node: yaml.MappingNode, key: str, counts: dict[int, int], above: set[int]
) -> int:
    count, lines = 0, {}
    for name, value in node.value:
        below = f"{key}.{name.value}" if key else str(name.value)
        if isinstance(name, yaml.ScalarNode) and name.tag != _MERGE:
            line = name.start_mark.line + 1
            if name.value in lines:
                shown = value.value if isinstance(value, yaml.ScalarNode) else "(a section)"
                raise DuplicateKeyError(below, shown, (lines[name.value], line))
            lines[name.value] = line
        elif not isinstance(name, yaml.ScalarNode):
            raise _marked("a key must be a word", name)
        count += _check(value, below, counts, above)
    return count


def _marked(problem: str, node: yaml.Node) -> yaml.YAMLError:
    return yaml.MarkedYAMLError(problem=problem, problem_mark=node.start_mark)


def yaml_words(error: yaml.YAMLError) -> str:
    """What is wrong with a text, in one sentence with its line.

    Args:
        error: What `read_yaml` raised.
    """
    mark = getattr(error, "problem_mark", None)
    if mark is None:
        return " ".join(str(error).split())
    place = f"line {mark.line + 1}, column {mark.column + 1}"
    problem = " ".join(" ".join(filter(None, (error.context, error.problem))).split())
    if r"'\t'" in problem:
        return f"a tab in {place}; YAML is indented with spaces"
    return f"{problem} in {place}"
