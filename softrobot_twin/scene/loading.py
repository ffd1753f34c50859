"""Reads a scene file. An error names file, key, value and unit.

In a scene file ``on`` is a key, not the truth value, and a key occurs once per section.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterable, Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any

import yaml
from pydantic import ValidationError
from yaml.composer import Composer
from yaml.constructor import SafeConstructor
from yaml.parser import Parser
from yaml.reader import Reader
from yaml.resolver import Resolver
from yaml.scanner import Scanner

from softrobot_twin.errors import SceneError
from softrobot_twin.geometry.cad_meshing import CAD_SUFFIXES
from softrobot_twin.scene.scene_parameters import changed_scene
from softrobot_twin.scene.patterns import Source, as_written, expand_patterns
from softrobot_twin.scene.refusal_messages import parts, scene_error
from softrobot_twin.scene.schema import Scene
from softrobot_twin.shared_files import given_file

try:
    from yaml.cyaml import CParser
except ImportError:
    CParser = None

MOST_BYTES, MOST_ENTRIES, MOST_LEVELS = 4_000_000, 50_000, 100
"""A text of more bytes, more entries with its anchors expanded, or sections nested more deeply is
not read."""


_MESHES = (".msh", ".vtk", ".vtu", ".inp", *CAD_SUFFIXES)


def read_changes(texts: Iterable[str]) -> dict[str, Any]:
    """Values of entries of a scene as they are given to a command.

    Args:
        texts: Each a key and its value (YAML), such as ``cables[0].tension=[0, 5]``.

    Raises:
        SceneError: A text is no key and value, or a key is given twice.
    """
    changes = {}
    for text in texts:
        key, sign, value = text.partition("=")
        key = key.strip()
        if not sign:
            raise SceneError(None, text, "", "", "must be KEY=VALUE, such as "
                             "body.material.young_modulus=1e5")
        if key in changes:
            raise SceneError(None, key, value, "", "is given twice")
        try:
            changes[key] = read_yaml(value)
        except yaml.YAMLError as error:
            raise SceneError(None, key, value, "", f"is not YAML: {yaml_words(error)}") from None
    return changes


def changes_of(path: Path | str) -> dict[str, Any]:
    """The values that the path of a scene carries; none but for a `ScenePath`.

    Args:
        path: YAML file.

    Raises:
        SceneError: See `read_changes`.
    """
    return read_changes(getattr(path, "changes", ()))


def load_scene(path: Path | str, changes: Mapping[str, Any] | None = None) -> Scene:
    """Reads and checks a scene.

    Args:
        path: YAML file; as in `given_file`.
        changes: Other values of its entries by their keys; see `changed_scene`. None for those of a
            `ScenePath`.

    Returns:
        The scene with its path; the paths of its files are relative to it.

    Raises:
        SceneError: The file cannot be read, or an entry is not valid.
    """
    if changes is None:
        changes = changes_of(path)
    if not isinstance(path, str | os.PathLike):
        raise SceneError(None, "scene_file", path, "", "must be the path of a YAML file")
    path = given_file(path)

    def refused(reason: str) -> SceneError:
        return SceneError(path, "scene_file", str(path), "", reason)

    if path.suffix.lower() in _MESHES:
        raise refused(f"is a mesh, not a scene: `softrobot_twin init {path.name}` writes a first "
                      "scene for it, a .yaml file that names it")
    try:
        byte_count = path.stat().st_size
        if byte_count > MOST_BYTES:
            raise refused(f"has {byte_count / 1e6:.0f} MB; a scene has at most "
                          f"{MOST_BYTES / 1e6:.0f} MB")
        text = path.read_text(encoding="utf-8-sig")
    except OSError as error:
        raise refused(error.strerror or str(error)) from None
    except ValueError:  # bytes that are not UTF-8, or a path with a null character
        raise refused("is not a text file (UTF-8)") from None
    try:
        mapping = read_yaml(text)
    except DuplicateKeyError as error:
        first, second = error.lines
        raise SceneError(
            path, error.key, error.value, "", f"is given twice, in lines {first} and {second}"
        ) from None
    except yaml.YAMLError as error:
        raise refused(f"is not YAML: {yaml_words(error)}") from None
    if mapping is None:
        raise refused("is empty; a scene is a mapping of keys to values")
    return changed_scene(scene_from_mapping(mapping, path), changes)


def scene_from_mapping(mapping: Any, path: Path | None = None) -> Scene:
    """Checks a scene in memory.

    Args:
        mapping: The content of a scene file.
        path: Path of the scene, for errors and for paths relative to it.

    Returns:
        The scene.

    Raises:
        SceneError: An entry is not valid.
    """
    if not isinstance(mapping, dict):
        found = "a list" if isinstance(mapping, list) else str(mapping)[:40]
        raise SceneError(path, "scene", found, "", "a scene is a mapping of keys to values")
    if "path" in mapping:
        raise SceneError(path, "path", mapping["path"], "", "is not a key of scenes")
    entries = expand_patterns(mapping, Scene, path)
    try:
        scene = Scene.model_validate({**entries, "path": path})
    except ValidationError as error:
        raise scene_error(error, Scene, path, as_written=lambda place: as_written(entries, place)) from None
    scene._source = Source(entries, mapping)
    return scene


def line_of_key(path: Path, key: str) -> int | None:
    """The line of a scene file in which a key is, or else the section that lacks it.

    Args:
        path: YAML file.
        key: Dotted path, such as ``cables[0].rate``.

    Returns:
        The line, counted from 1; None where the file cannot be read or has no such section.
    """
    try:
        found = path.stat()
        node, places = _root(path, found.st_mtime_ns, found.st_size), parts(key)
    except (OSError, ValueError, yaml.YAMLError):
        return None
    line = None
    for part in places:
        items = node.value if isinstance(node, yaml.SequenceNode) else ()
        if isinstance(part, int) and part < len(items):
            node = items[part]
            line = node.start_mark.line + 1
            continue
        pairs = node.value if isinstance(node, yaml.MappingNode) else ()
        named = [pair for pair in pairs if pair[0].value == str(part)]
        if not named:  # or one entry in place of a list
            break
        line, node = named[0][0].start_mark.line + 1, named[0][1]
    return line


@lru_cache(maxsize=1)
def _root(path: Path, changed: int, byte_count: int) -> yaml.Node | None:
    """The entries of a file with their lines."""
    if byte_count > MOST_BYTES:
        return None
    return _SceneYaml(path.read_text(encoding="utf-8-sig")).get_single_node()


SceneError.line_of_key = staticmethod(line_of_key)


def written_out(mapping: Any, path: Path | None = None) -> Any:
    """A scene with copies in place of its repeated entries, as one would write it by hand.

    Args:
        mapping: The content of a scene file.
        path: Path of the scene, for errors.

    Returns:
        The content of a scene without patterns, in new sections and lists.

    Raises:
        SceneError: A pattern is not valid.
    """
    return _plain(expand_patterns(mapping, Scene, path))


def _plain(value: Any, of_leaf: Callable[[Any], Any] = lambda leaf: leaf) -> Any:
    """Sections and lists as new dictionaries and lists, with what becomes of each value in them."""
    if isinstance(value, dict):
        return {key: _plain(one, of_leaf) for key, one in value.items()}
    return [_plain(one, of_leaf) for one in value] if isinstance(value, list | tuple) else of_leaf(value)


def text_of(scene: Scene, folder: Path | None = None) -> str:
    """A scene as the text of a file, with all that was changed.

    Args:
        scene: The scene.
        folder: Folder of the file, from which other files are named; None where it may stand in any.
    """
    def written(value: Any) -> Any:
        if not isinstance(value, Path):
            return value
        path = scene.file_path(value)
        return str(path) if folder is None else os.path.relpath(path, folder)

    content = _plain(scene.model_dump(exclude_unset=True), written)
    return yaml.safe_dump(content, sort_keys=False, allow_unicode=True, default_flow_style=None, width=100)


# --- YAML ----------------------------------------------------------------------------------------


class DuplicateKeyError(yaml.YAMLError):  # type: ignore[misc]
    """A key occurs twice in one section.

    Attributes:
        key: Dotted path of the key, such as ``cables[0].rate``.
        value: Its second value.
        lines: Both lines, counted from 1.
    """

    def __init__(self, key: str, value: str, lines: tuple[int, int]):
        self.key, self.value, self.lines = key, value, lines
        super().__init__(f"{key} is given twice, in lines {lines[0]} and {lines[1]}")


# The parser of libyaml is ten times as fast; PyYAML has it wherever it is installed as a wheel.
_PARSER: tuple = (Reader, Scanner, Parser) if CParser is None else (CParser,)


class _SceneYaml(Composer, *_PARSER, SafeConstructor, Resolver):  # type: ignore[misc]
    """Accepts only ``true`` and ``false`` as truth values, as YAML 1.2 does, and refuses a text
    while it is read when its entries are too many or nested too deeply."""

    def __init__(self, text: str):
        for base in _PARSER:
            base.__init__(self, *((text,) if base in (CParser, Reader) else ()))
        for base in (Composer, SafeConstructor, Resolver):
            base.__init__(self)
        self._count = self._level = 0

    def compose_node(self, parent, index):
        self._count, self._level = self._count + 1, self._level + 1
        if self._count > MOST_ENTRIES:
            raise yaml.YAMLError(f"it has more than {MOST_ENTRIES} entries")
        if self._level > MOST_LEVELS:
            raise yaml.YAMLError("its sections are nested too deeply")
        node = super().compose_node(parent, index)
        self._level -= 1
        return node

    def flatten_mapping(self, node):
        """Merges sections: a section's own value counts, then that of the one that is named first.

        PyYAML 6.0.4 takes the overridden value where a merged section has merged another one.
        """
        own = [(name, value) for name, value in node.value if name.tag != _MERGE]
        merged, names = dict[str, tuple[yaml.Node, yaml.Node]](), {name.value for name, _ in own}
        for name, value in node.value:
            if name.tag != _MERGE:
                continue
            for section in value.value if isinstance(value, yaml.SequenceNode) else [value]:
                if not isinstance(section, yaml.MappingNode):
                    raise _marked("only sections can be merged", section)
                self.flatten_mapping(section)
                for pair in section.value:
                    merged.setdefault(pair[0].value, pair)
        node.value = [pair for name, pair in merged.items() if name not in names] + own


TRUTH = re.compile(r"^(?:true|True|TRUE|false|False|FALSE)$")
BOOL = "tag:yaml.org,2002:bool"
_MERGE, _INT = "tag:yaml.org,2002:merge", "tag:yaml.org,2002:int"
_MOST_DIGITS = 300
_SceneYaml.yaml_implicit_resolvers = {
    first: [(tag, pattern) for tag, pattern in resolvers if tag != BOOL]
    for first, resolvers in yaml.SafeLoader.yaml_implicit_resolvers.items()
}
_SceneYaml.add_implicit_resolver(BOOL, TRUTH, "tTfF")


def read_yaml(text: str) -> Any:
    """The content of a YAML text.

    Args:
        text: The file's content.

    Returns:
        Mappings, sequences and values.

    Raises:
        yaml.YAMLError: The text is not YAML, or a key occurs twice in one section.
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
    except yaml.MarkedYAMLError as error:
        if "nesting depth" in str(error.problem):  # of libyaml, which reads ahead
            raise yaml.YAMLError("its sections are nested too deeply") from None
        raise
    except (ValueError, OverflowError) as error:  # an invalid date or number
        raise yaml.YAMLError(str(error)) from None


def _check(node: yaml.Node, key: str, counts: dict[int, int], above: set[int]) -> int:
    """Refuses duplicate keys and unbounded anchors; returns the number of expanded entries."""
    if id(node) in counts:
        return counts[id(node)]
    if id(node) in above:
        raise _marked("an anchor contains itself", node)
    above.add(id(node))
    count = 1
    if isinstance(node, yaml.ScalarNode) and node.tag == _INT and len(node.value) > _MOST_DIGITS:
        raise _marked(f"a whole number has more than {_MOST_DIGITS} digits", node)
    if isinstance(node, yaml.SequenceNode):
        for index, item in enumerate(node.value):
            count += _check(item, f"{key}[{index}]", counts, above)
    elif isinstance(node, yaml.MappingNode):
        count += _check_section(node, key, counts, above)
    above.remove(id(node))
    if count > MOST_ENTRIES:
        raise _marked(f"its anchors expand to more than {MOST_ENTRIES} entries", node)
    counts[id(node)] = count
    return count


def _check_section(node: yaml.MappingNode, key: str, counts: dict[int, int], above: set[int]) -> int:
    count, lines = 0, dict[str, int]()
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
    """The error of a text in one sentence, with line and column.

    Args:
        error: The error of `read_yaml`.
    """
    mark = getattr(error, "problem_mark", None)
    if mark is None:
        return " ".join(str(error).split())
    place = f"line {mark.line + 1}, column {mark.column + 1}"
    problem = " ".join(" ".join(filter(None, (error.context, error.problem))).split())
    if r"'\t'" in problem or "found a tab" in problem:
        return f"a tab in {place}; YAML requires spaces for indentation"
    return f"{problem} in {place}"
