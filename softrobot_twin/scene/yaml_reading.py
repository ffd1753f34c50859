"""YAML as scenes are written: ``on`` is a key, not the word for true."""

from __future__ import annotations

import re
from typing import Any

import yaml


class _SceneYaml(yaml.SafeLoader):
    """Reads only ``true`` and ``false`` as truth values, as YAML 1.2 does."""


TRUTH = re.compile(r"^(?:true|True|TRUE|false|False|FALSE)$")
BOOL = "tag:yaml.org,2002:bool"
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
        yaml.YAMLError: The text is not YAML.
    """
    return yaml.load(text, Loader=_SceneYaml)  # noqa: S506: a safe loader
