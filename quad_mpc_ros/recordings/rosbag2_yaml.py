"""YAML in the style of rosbag2."""

from __future__ import annotations

from typing import Any

import yaml


def dump_yaml(value: object) -> str:
    """Return ``value`` as block YAML the way yaml-cpp, and with it rosbag2, lays it out.

    Lists inside mappings are indented, an empty text is ``""``, nothing is ``~``, keys keep
    their order, and there is no newline at the end.
    """
    text: str = yaml.dump(
        value, Dumper=_Rosbag2Dumper, sort_keys=False, allow_unicode=True, width=float("inf")
    )
    return text.removesuffix("\n")


class _Rosbag2Dumper(yaml.SafeDumper):
    def increase_indent(self, flow: bool = False, indentless: bool = False) -> Any:
        return super().increase_indent(flow, False)

    def ignore_aliases(self, data: object) -> bool:
        # Two publishers with the same QoS are two entries, not an anchor and an alias.
        return True


def _represent_text(dumper: Any, text: str) -> Any:
    style = None if text else '"'
    return dumper.represent_scalar("tag:yaml.org,2002:str", text, style=style)


def _represent_nothing(dumper: Any, _: None) -> Any:
    return dumper.represent_scalar("tag:yaml.org,2002:null", "~")


_Rosbag2Dumper.add_representer(str, _represent_text)
_Rosbag2Dumper.add_representer(type(None), _represent_nothing)
