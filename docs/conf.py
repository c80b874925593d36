# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""How Sphinx makes the documentation: ``make docs``.

Its source is the whole checkout, so that README.md, CONTRIBUTING.md and the pages of docs/ link to
each other here as they do on a code host. The pages of the rooms are made from their docstrings.
"""

from __future__ import annotations

from importlib.metadata import version as installed_version
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from sphinx.application import Sphinx

project = "quad_mpc_ros"
author = "quad_mpc_ros maintainers"
version = release = installed_version("quad_mpc_ros")

extensions = [
    "myst_parser",
    "sphinx.ext.apidoc",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
]
root_doc = "docs/index"
include_patterns = [
    "README.md",
    "CONTRIBUTING.md",
    "QUALITY_DECLARATION.md",
    "CHANGELOG.rst",
    "examples/README.md",
    "docs/**.md",
    "build/api/quad_mpc_ros*.rst",
]

# Links to headings, as code hosts make them.
myst_heading_anchors = 4
# Parameters are called Q and R; a code host shows them as they are.
myst_enable_extensions = ["dollarmath"]

# Packages with a public interface for other programs.
_ROOMS = {
    "analysis",
    "control",
    "recordings",
    "references",
    "simulation",
}
_PACKAGE = Path(__file__).parents[1] / "quad_mpc_ros"
apidoc_modules = [
    {
        "path": str(_PACKAGE),
        "destination": "build/api",
        "exclude_patterns": [
            str(path) for path in _PACKAGE.glob("[!_]*") if path.name not in _ROOMS
        ],
        "module_first": True,
        "automodule_options": {"members"},
    }
]
# Each name where it is defined, and nowhere else.
autodoc_default_options = {"ignore-module-all": True}
autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_preserve_defaults = True
napoleon_numpy_docstring = False
napoleon_use_ivar = True  # fields of dataclasses are listed once, by autodoc

toc_object_entries = False  # hundreds of names, copied into the navigation of every page

html_theme = "furo"
html_extra_path = ["index.html"]  # leads to docs/index.html
html_title = f"quad_mpc_ros {version}"
html_show_copyright = False


def setup(app: Sphinx) -> None:
    """Called by Sphinx."""
    app.connect("autodoc-process-docstring", _keep_norms)


def _keep_norms(*arguments: Any) -> None:
    """Let |x| be a norm or an absolute value, not a substitution of reStructuredText."""
    lines: list[str] = arguments[-1]
    lines[:] = [
        "``".join(
            part.replace("|", r"\|") if number % 2 == 0 else part
            for number, part in enumerate(line.split("``"))
        )
        for line in lines
    ]
