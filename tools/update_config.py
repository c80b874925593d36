"""Write config/<node>.yaml, docs/parameters.md and the table of docs/soak.md from the code.

The table of docs/soak.md is written from the faults. Run it after changing one of either; a test
fails while the files are not what it would write.
"""

from __future__ import annotations

from pathlib import Path

from quad_mpc_ros.commands.params import as_markdown, as_yaml, own_nodes
from quad_mpc_ros.experiments.faults.cases import fault_table
from quad_mpc_ros.ros.bridges.registry import bridge_configurations, bridge_packages

ROOT = Path(__file__).resolve().parents[1]

OURS = {name for name, package in bridge_packages().items() if package == "quad_mpc_ros"}
BRIDGES = {name: kind for name, kind in bridge_configurations().items() if name in OURS}
if missing := OURS - BRIDGES.keys():
    raise SystemExit(f"setup.py has changed ({', '.join(sorted(missing))}): install it again")
ALL_NODES = {**own_nodes(), **BRIDGES}

_SOAK_PAGE = Path("docs", "soak.md")
_TABLE_BEGINS, _TABLE_ENDS = "<!-- faults -->", "<!-- end of faults -->"

_PAGE = """\
# Parameters

What can be set, node by node; `quad_mpc params` prints the same. Written by
`tools/update_config.py` from the dataclasses that declare the parameters; edit those. *Live*
parameters may change in flight (`ros2 param set`), the others only at the start, or, of a node
with a [lifecycle](lifecycle.md), while it is unconfigured. What is misspelt or wrong in a file or
on a command line is [refused](lifecycle.md#what-is-refused-at-the-start).
"""


def files() -> dict[Path, str]:
    """Return the text of every generated file."""
    texts = {
        Path("config", f"{node}.yaml"): (
            f"# Every parameter of the {node} node with its default value.\n"
            f"{as_yaml(node, kind.specs())}"
        )
        for node, kind in ALL_NODES.items()
    }
    sections = [as_markdown(node, kind.specs()) for node, kind in ALL_NODES.items()]
    texts[Path("docs", "parameters.md")] = "\n".join([_PAGE, *sections])
    texts[_SOAK_PAGE] = _soak_page()
    return texts


def _soak_page() -> str:
    """Return the page with the table of faults renewed."""
    before, rest = (ROOT / _SOAK_PAGE).read_text(encoding="utf-8").split(_TABLE_BEGINS)
    _, after = rest.split(_TABLE_ENDS)
    return f"{before}{_TABLE_BEGINS}\n{fault_table()}\n{_TABLE_ENDS}{after}"


if __name__ == "__main__":
    for path, text in files().items():
        (ROOT / path).write_text(text, encoding="utf-8")
